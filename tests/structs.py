"""Instances of Warp's structs, seen from outside."""


def is_struct(value):
    """Whether a value is an instance of a struct of Warp's."""
    return hasattr(type(value), "native_name")


def fields(struct):
    """Return the values of a struct's fields by name."""
    return {name: value for name, value in vars(struct).items() if not name.startswith("_")}
