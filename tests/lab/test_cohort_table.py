"""Patient tables: what people write, what is refused and how, and the table of columns."""

import dataclasses
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from myowarp.definitions.condition import CONDITIONS
from myowarp.definitions.task import TASKS
from myowarp.extras import to_install
from myowarp.process import warn_once
from myowarp.sim.simulation import Simulation

pd = pytest.importorskip("pandas")
pytest.importorskip("pyarrow")

from myowarp.apps.studies.cohort import COLUMNS, plan, run, run_cohort  # noqa: E402
from myowarp.sim.patient_columns import conditions_of  # noqa: E402
from myowarp.sim.patient_table import read_population  # noqa: E402

ELBOW, HAND, REACH = "myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v1", "myoHandReachFixed-v0"
ELBOW_MUSCLES = ("TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA")
EXAMPLES = Path(__file__).parents[2] / "examples"
PATIENTS = pd.DataFrame(
    {
        "patient": ["Ada", "Ben", "Cleo", "Dan"],
        "strength": [1.0, 0.4, 0.7, 0.2],
        "load_mass": [0, 2, 5, 1],
        "tendon_tear": ["", "BRA", "BRA+TRIlat", None],
    }
)


@pytest.fixture
def nothing_built(monkeypatch):
    """Whoever builds a simulation fails."""

    def refuse(*args, **options):
        pytest.fail("a simulation was built")

    monkeypatch.setattr(run, "Simulation", refuse)


@pytest.mark.parametrize("name", COLUMNS)
def test_columns_are_parameters_of_conditions(name):
    column = COLUMNS[name]
    fields = {field.name for field in dataclasses.fields(CONDITIONS[column.condition])}
    assert column.parameter in fields


NUMBERS = [name for name in COLUMNS if type(COLUMNS[name]).__name__ in ("CohortColumn", "Share")]


@pytest.mark.parametrize("name", NUMBERS)
def test_ranges_are_the_conditions_own(name):
    """What the table refuses at its ends the condition would refuse too; what it takes, it takes."""
    column = COLUMNS[name]
    partner = {"tear_time": {"tendon_tear": [("BRA",)]}}.get(name, {})

    def build(value):
        conditions = conditions_of({name: [value], **partner}, TASKS[ELBOW])
        Simulation(TASKS[ELBOW], 1, device="cpu", conditions=conditions, graph=False, progress=False)

    with pytest.raises(ValueError, match=column.parameter):
        build(column.low - 0.1)
    build(column.high if column.high < np.inf else 3.0)
    if type(column).__name__ == "Share":
        with pytest.raises(ValueError, match=column.parameter):
            build(1.01 * column.high)
    with pytest.raises(ValueError):  # noqa: PT011 (the message is made of the column's by the reader)
        column.parse(column.low - 0.1, ())


def test_entries_that_are_drawn_or_change():
    """Each world has its patient's own: numbers, ranges and changes beside each other."""
    table = pd.DataFrame({"strength": [0.5, "0.2..0.4", "1 -> 0.3 @ 0.2", "1 -> 0.1..0.2 @ 0.1..0.3"]})
    entries = read_population(table, ELBOW_MUSCLES).entries
    sim = Simulation(
        TASKS[ELBOW], 8, device="cpu", conditions=conditions_of(entries, TASKS[ELBOW], 2), progress=False
    )
    sim.reset(seeds=np.arange(8))
    seen = []
    for _ in range(20):
        sim.step()
        seen.append(sim.scene.muscles.anatomy.strength.numpy()[:, 0].copy())
    seen, change = np.array(seen), round(0.2 / sim.scene.control_dt)
    assert (seen[:, :2] == 0.5).all()
    assert (seen[:, 2:4] == seen[0, 2:4]).all()
    assert ((seen[0, 2:4] >= 0.2) & (seen[0, 2:4] <= 0.4)).all()
    assert seen[0, 2] != seen[0, 3]
    np.testing.assert_allclose(seen[:change, 4:6], 1.0)
    np.testing.assert_allclose(seen[change:, 4:6], 0.3)
    assert (seen[0, 6:] == 1.0).all()
    assert ((seen[-1, 6:] >= 0.1) & (seen[-1, 6:] <= 0.2)).all()


@pytest.mark.parametrize(
    ("column", "entry"),
    [
        ("strength", "0.7..0.3"),
        ("strength", "1 -> x"),
        ("strength", "1 -> 0.3 @"),
        ("strength", "1 -> 0.3 @ -1"),
        ("strength", "1 -> -0.3"),
        ("initial_fatigue", "0 -> 1 @ 1"),  # acts where an episode begins
        ("tear_time", "0 -> 1 @ 1"),
        ("tendon_transfer", "0..1"),
        ("tendon_transfer", "0 -> 0.5 @ 1"),
    ],
)
def test_wrong_courses(column, entry):
    with pytest.raises(ValueError, match=f"column '{column}': needs .*, of which each is .*, got '{entry}'"):
        read_population(pd.DataFrame({column: [entry], "tendon_tear": ["BRA"]}), ELBOW_MUSCLES)


@pytest.mark.parametrize(
    "text",
    [
        "patient,strength,tendon_tear\nA,0.5,\nB,1,BRA\n",
        "﻿patient;strength;tendon_tear\r\nA;0.5;\r\nB;1;BRA\r\n",
        "patient\tstrength\ttendon_tear\n A \t 0.5 \t\n\nB\t1\t BRA \n",
        '"patient","strength","tendon_tear"\n"A",0.50,""\n"B",1e0,"BRA+BRA"\n',
    ],
)
def test_tables_that_people_write(tmp_path, text):
    path = tmp_path / "patients.csv"
    path.write_text(text, encoding="utf-8")
    population = read_population(path, ELBOW_MUSCLES)
    assert population.patients == ("A", "B")
    assert population.entries == {"strength": [0.5, 1.0], "tendon_tear": [(), ("BRA",)]}


def test_parquet_and_frames_are_like_csv(tmp_path):
    PATIENTS.to_parquet(tmp_path / "patients.parquet")
    PATIENTS.to_csv(tmp_path / "patients.csv", index=False)
    tables = [
        PATIENTS,
        tmp_path / "patients.parquet",
        str(tmp_path / "patients.csv"),
        PATIENTS.convert_dtypes(),
    ]
    populations = [read_population(table, ELBOW_MUSCLES) for table in tables]
    assert all(population == populations[0] for population in populations)
    nullable = pd.DataFrame({"tendon_transfer": pd.array([True, False]), "strength": np.float32([1, 0.5])})
    assert read_population(nullable, ()).entries == {"tendon_transfer": [1.0, 0.0], "strength": [1.0, 0.5]}


def test_names_in_the_index_of_a_frame():
    population = read_population(PATIENTS.set_index("patient"), ELBOW_MUSCLES)
    assert population == read_population(PATIENTS, ELBOW_MUSCLES)


def test_the_mass_of_an_exoskeleton_brings_no_assistance():
    (brace,) = conditions_of({"exo_mass": [0.0, 0.5]}, TASKS[ELBOW])
    assert brace.assistance.tolist() == [0.0, 0.0]
    assert brace.forearm_mass.tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"tendon_tear": ["", "BRA", "BRA"], "tear_time": [9, 1.9, 150]},
            "cohort column 'tear_time' changes nothing in 1 of 3 patients: an episode ends at 2 s, row 3 "
            "(patient '3') has 150.0",
        ),
        (
            {"strength": ["1 -> 0.3 @ 2..3", "1 -> 0.3 @ 1..3", 0.5]},
            "cohort column 'strength' changes nothing in 1 of 3 patients: an episode ends at 2 s, row 1 "
            "(patient '1') has 1 -> 0.3 @ 2..3",
        ),
        ({"tendon_tear": ["BRA"], "tear_time": [1]}, ""),
    ],
)
def test_what_begins_after_the_end_is_said(caplog, columns, message):
    warn_once.cache_clear()
    plan.plan_cohort(pd.DataFrame(columns), ELBOW, steps=100)
    assert caplog.messages == [message] * bool(message)


def test_names_of_muscles_may_lack_their_side():
    names = ("FPL_r", "EPL_r")
    table = pd.DataFrame({"tendon_tear": ["FPL", "EPL_r + FPL", ""]})
    assert read_population(table, names).entries["tendon_tear"] == [("FPL_r",), ("EPL_r", "FPL_r"), ()]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "strength\n1\n\n-0.5\n",
            r"^cohort row 2 \(patient '2'\), column 'strength': needs a share from 0 to 4, such as 0\.3 for "
            r"30 %, got '-0\.5'$",
        ),
        (
            "exo_assistance\n40\n",
            r"^cohort row 1 \(patient '1'\), column 'exo_assistance': needs a share from 0 to 4, such as "
            r"0\.3 for 30 %, got '40'$",
        ),
        (
            "patient,strength\nA,\n",
            r"^cohort row 1 \(patient 'A'\), column 'strength': needs a share from 0 to 4, such as 0\.3 for "
            r"30 %, got nothing$",
        ),
        (
            "patient;load_mass\nA;0,5\n",
            r"^cohort row 1 \(patient 'A'\), column 'load_mass': needs a number from 0 to 100 kg, got '0,5'$",
        ),
        (
            "patient,load_mass\nA,2500\n",
            r"^cohort row 1 \(patient 'A'\), column 'load_mass': needs a number from 0 to 100 kg, "
            r"got '2500'$",
        ),
        (
            "patient,initial_fatigue\nA,0\nB,1.5\n",
            r"^cohort row 2 \(patient 'B'\), column 'initial_fatigue': needs a number from 0 to 1, "
            r"got '1\.5'$",
        ),
        (
            "patient,fatigue_rate\nA,inf\n",
            r"^cohort row 1 \(patient 'A'\), column 'fatigue_rate': needs a number from 0 to 10 1/s, "
            r"got 'inf'$",
        ),
        (
            "patient,tendon_transfer\nA,yes\n",
            r"^cohort row 1 \(patient 'A'\), column 'tendon_transfer': needs 0 or 1, got 'yes'$",
        ),
        (
            "patient,tendon_tear\nA,BIC\n",
            r"^cohort row 1 \(patient 'A'\), column 'tendon_tear': needs the name of a muscle, several "
            r"joined by \+, or nothing, got 'BIC' \(muscle 'BIC' unknown; "
            r"did you mean BIClong, BICshort\?\)$",
        ),
        ("patient,strenght\nA,1\n", r"^cohort column 'strenght' unknown; did you mean strength\?$"),
        (
            "patient,qqq\nA,1\n",
            r"^cohort column 'qqq' unknown; available: strength, fatigue_rate, .*noise_constant$",
        ),
        ("strength,strength\n1,1\n", r"^cohort column 'strength' is there twice; leave one out$"),
        ("patient,strength\nA,1\nB,1\nA,1\n", r"^cohort rows 1 and 3 are both patient 'A'; names differ$"),
        ("patient,strength\n ,1\n", r"^cohort row 1, column 'patient': needs a name, got nothing$"),
        ("patient,strength\nA,1,2\n", r"^cohort row 1 has 3 entries for 2 columns: \['A', '1', '2'\]$"),
        (
            "patient,strength\n",
            r"^cohort table '.*patients\.csv' has no rows; it needs one for every patient$",
        ),
        ("", r"^cohort table '.*patients\.csv' has no rows; it needs one for every patient$"),
        (
            "tendon_transfer,reafferentation\n1,0\n1,1\n",
            r"^cohort row 2 \(patient '2'\) has both tendon_transfer and reafferentation; "
            r"set one of them to 0$",
        ),
        ("tear_time\n1\n", r"^cohort column tear_time: it needs column tendon_tear, which says what tears$"),
        (
            "strength,fatigue_rate,force_loss_rate\n1,0,0\n",
            r"^cohort columns strength, fatigue_rate, force_loss_rate: conditions 'fatigue_3ccr' and "
            r"'fatigue_ma2009' both set fatigue; leave one out$",
        ),
        (
            "tendon_transfer\n1\n",
            r"^cohort column tendon_transfer: body 'elbow' cannot have a tendon transfer; .*$",
        ),
    ],
)
def test_bad_tables(tmp_path, nothing_built, text, message):
    path = tmp_path / "patients.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        run_cohort(path, ELBOW)


def test_an_exoskeleton_on_a_hand(nothing_built):
    with pytest.raises(
        ValueError,
        match=r"^cohort column exo_assistance: body 'hand' cannot wear an exoskeleton; "
        r"bodies that can: elbow$",
    ):
        run_cohort(pd.DataFrame({"strength": [1], "exo_assistance": [0.5]}), HAND)


@pytest.mark.parametrize(
    ("column", "cell", "got"),
    [
        ("strength", None, "nothing"),
        ("strength", np.nan, "nothing"),
        ("strength", True, "True"),
        ("strength", "weak", "'weak'"),
        ("strength", np.float64(-1), "-1.0"),
        ("strength", [1], r"\[1\]"),
    ],
)
def test_bad_cells_of_frames(column, cell, got):
    table = pd.DataFrame({column: pd.Series([cell], dtype=object)})
    with pytest.raises(
        ValueError, match=rf"^cohort row 1 \(patient '1'\), column '{column}': needs .*, got {got}$"
    ):
        read_population(table, ())


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("none.csv", r"^cohort table 'none\.csv' does not exist$"),
        ("patients.xlsx", r"^cohort table 'patients\.xlsx' must end in \.csv or \.parquet$"),
        ([1, 2], r"^a cohort table is a path or a DataFrame, got list$"),
    ],
)
def test_what_is_no_table(table, message):
    with pytest.raises(ValueError, match=message):
        read_population(table, ())


def test_files_that_are_something_else(tmp_path):
    for name, message in (("a.parquet", "is no Parquet file"), ("a.csv", "is not UTF-8 text")):
        (tmp_path / name).write_bytes(b"\xff\xfe\x00PK")
        with pytest.raises(ValueError, match=rf"^cohort table '.*{name}' {message} \(.*\)$"):
            read_population(tmp_path / name, ())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, r"^--steps must be at least 1, got 0$"),
        ({"trials": 1.5}, r"^--trials must be an integer, got 1\.5$"),
        ({"every": 0}, r"^--every must be at least 1, got 0$"),
        ({"seed": -1}, r"^--seed must be at least 0, got -1$"),
        ({"physics": "slow"}, r"^physics 'slow' unknown; available: parity, fast$"),
        ({"reset": "never"}, r"^reset 'never' unknown; available: task, fixed, random, none$"),
        ({"device": "cuda:9"}, r"^device 'cuda:9' is not available; available: .*$"),
        ({"policy": "best"}, r"^policy 'best' unknown; available: random, zero, hold, .*$"),
        ({"task": "myoElbow-v0"}, r"^task 'myoElbow-v0' unknown; .*$"),
        (
            {"task": REACH},
            r"^policy 'hold' follows joint errors, which task 'myoHandReachFixed-v0' of family 'reach' does "
            r"not observe; use it in pose tasks$",
        ),
        (
            {"task": "motorFingerPoseFixed-v0"},
            r"^a cohort is about muscles; the body of task 'motorFingerPoseFixed-v0' has none$",
        ),
    ],
)
def test_bad_arguments(nothing_built, options, message):
    with pytest.raises(ValueError, match=message):
        run_cohort(PATIENTS, **{"what": ELBOW} | options)


def test_without_pandas(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        ImportError,
        match=rf"^a cohort needs pandas, which is not installed; run {re.escape(to_install('cohort'))}$",
    ):
        run_cohort(PATIENTS, ELBOW)


def test_example_is_what_its_script_writes(tmp_path):
    script = tmp_path / "elbow_cohort.py"
    script.write_text((EXAMPLES / "elbow_cohort.py").read_text())
    runpy.run_path(str(script))
    assert (tmp_path / "elbow_cohort.csv").read_text() == (EXAMPLES / "elbow_cohort.csv").read_text()
    population = read_population(EXAMPLES / "elbow_cohort.csv", ELBOW_MUSCLES)
    assert len(population.patients) == 1000
    assert conditions_of(population.entries, TASKS[ELBOW])
