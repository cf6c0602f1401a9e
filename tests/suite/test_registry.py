"""The registry: order, duplicates, and the sentence for an unknown name."""

import pytest

import myowarp.tasks  # noqa: F401
from myowarp.definitions.body import BODIES
from myowarp.definitions.muscle import MUSCLES
from myowarp.definitions.registry import Registry
from myowarp.definitions.task import TASKS


@pytest.fixture
def fruits():
    registry = Registry("fruit")
    for name in ("pear", "apple", "cherry"):
        registry.add(name, name.upper())
    return registry


def test_is_an_ordered_mapping(fruits):
    assert list(fruits) == ["pear", "apple", "cherry"]
    assert len(fruits) == 3
    assert "apple" in fruits
    assert "banana" not in fruits
    assert fruits["apple"] == "APPLE"


def test_add_and_decorator_return_the_entry(fruits):
    def grape():
        pass

    assert fruits.register("grape")(grape) is grape
    assert fruits["grape"] is grape
    assert fruits.add("fig", 7) == 7


def test_taken_name(fruits):
    with pytest.raises(ValueError, match=r".") as error:
        fruits.add("apple", "other")
    assert (
        str(error.value) == "fruit 'apple' is already registered; choose another name, or pass replace=True"
    )
    assert fruits["apple"] == "APPLE"


def test_replaced_if_asked(fruits):
    fruits.seal()
    fruits.add("fig", 7)
    assert fruits.add("fig", 8, replace=True) == 8
    assert list(fruits) == ["pear", "apple", "cherry", "fig"]
    with pytest.raises(ValueError, match=r"^fruit 'pear' belongs to myowarp; choose another name$"):
        fruits.add("pear", 1, replace=True)
    assert fruits["pear"] == "PEAR"


def test_who_watches_is_told_and_may_refuse(fruits):
    told = []

    def watch(name):
        told.append(name)
        if name == "stone":
            raise ValueError("no fruit")

    fruits.watch(watch)
    fruits.add("fig", 7)
    with pytest.raises(ValueError, match=r"^no fruit$"):
        fruits.add("stone", 0)
    assert told == ["pear", "apple", "cherry", "fig", "stone"]
    assert "stone" not in fruits


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("appel", "fruit 'appel' unknown; did you mean apple?"),
        ("xyz", "fruit 'xyz' unknown; available: pear, apple, cherry"),
        (3, "fruit 3 unknown; available: pear, apple, cherry"),
    ],
)
def test_unknown_name(fruits, name, message):
    with pytest.raises(ValueError, match=r".") as error:
        fruits[name]
    assert str(error.value) == message


@pytest.mark.parametrize("registry", [BODIES, MUSCLES, TASKS], ids=lambda r: r.kind)
def test_what_is_registered_is_found_under_its_name(registry):
    assert len(registry) >= 1
    for name in registry:
        assert registry[name] is not None


def test_tasks_are_registered_under_their_key():
    assert len(TASKS) >= 37
    for key in TASKS:
        assert TASKS[key].key == key
        assert TASKS[key].body in BODIES


def test_unknown_muscle_model():
    with pytest.raises(ValueError, match=r".") as error:
        MUSCLES["hill"]
    assert str(error.value) == f"muscle model 'hill' unknown; available: {', '.join(MUSCLES)}"


def test_unknown_name_lists_all_close_names(fruits):
    for name in ("apples", "applet", "appleton"):
        fruits.add(name, name)
    with pytest.raises(ValueError, match=r".") as error:
        fruits["applee"]
    assert str(error.value) == "fruit 'applee' unknown; did you mean apple, applet, apples?"
