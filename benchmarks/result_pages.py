"""docs/results from the committed measurements: python -m benchmarks.result_pages.

The words of a page are `benchmarks/result_texts/<page>.md`; its fields are the functions here.
"""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from myowarp.apps.reports.table import markdown
from myowarp.disk import in_place

ROOT = Path(__file__).parents[1]
RESULTS, TEXTS, PAGES = (
    ROOT / "benchmarks/results",
    Path(__file__).parent / "result_texts",
    ROOT / "docs/results",
)
OPENSIM_SPEED = ROOT / "myowarp/apps/studies/reproduce/opensim_speed.json"
NOTE = "<!-- `python -m benchmarks.result_pages` writes this page; edits here are lost. -->"
NAMES = {
    "FullBodyModel_Hamner2010_v2_0": "Hamner2010",
    "MoBL_ARMS": "MoBL-ARMS",
    "gait2354_simbody": "gait2354",
    "gait2392_millard2012muscle": "gait2392 (Millard)",
    "gait2392_millard2012muscle_20303": "gait2392 (Millard, version 20303)",
    "subject_walk_scaled": "example3DWalking",
}
PRESETS = ("parity", "fast")
STEPS = ("0.5 ms", "1 ms", "2 ms", "5 ms")
PERCENT = 100.0


def read(name: str) -> dict[str, Any]:
    """Return a committed result."""
    result: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())
    return result


def renewed(page: Path, program: str, text: str) -> str:
    """Return a page with another text in the place that a program writes."""
    begin, end = f"<!-- written by: python -m {program} -->\n", "<!-- end of what is written -->"
    before, _, rest = page.read_text().partition(begin)
    return f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}"


def number(value: float, digits: int = 2) -> str:
    """Return a number in so many significant digits; from a hundred on without an exponent."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:,.0f}" if abs(rounded) >= 100 else f"{rounded:.{digits}g}"


def span(values: Iterable[float], digits: int = 2) -> str:
    """Return the least and the greatest of some numbers."""
    found = list(values)
    low, high = number(min(found), digits), number(max(found), digits)
    return low if low == high else f"{low} to {high}"


def name_of(model: str) -> str:
    """Return the name under which a model is known."""
    return NAMES.get(model, model)


# Speed


def rates(row: dict[str, Any]) -> dict[str, float]:
    """Return steps a second of all contestants; MyoSuite's are the better of its two."""
    found = {who: entry["env_steps_per_s"]["median"] for who, entry in row["contestants"].items()}
    if "MyoSuite" in found:
        found["MyoSuite"] = max(found["MyoSuite"], found["MyoSuite async"])
    return found


RIVALS = ("MuJoCo C", "EnvPool", "MyoSuite")


def steps_table(result: str) -> str:
    """Return steps a second of 256 worlds and of rivals."""
    columns = {f"{preset} 256": f"MyoWarp `{preset}`" for preset in PRESETS} | {who: who for who in RIVALS}
    rows = []
    for family, row in read(result)["families"].items():
        found = rates(row)
        rows.append((family, *(number(found[who], 3) if who in found else "" for who in columns)))
    return markdown(("family", *columns.values()), rows)


def ratio_table(result: str) -> str:
    """Return the ratios of these medians."""
    columns = [(preset, rival) for rival in RIVALS for preset in PRESETS]
    rows = []
    for family, row in read(result)["families"].items():
        found = rates(row)
        over = (number(found[f"{p} 256"] / found[r]) if r in found else "" for p, r in columns)
        rows.append((family, *over))
    return markdown(("family", *(f"`{preset}` / {rival}" for preset, rival in columns)), rows)


def disturbed(result: str) -> str:
    """Return in how many measurements others kept more than 0.1 cores busy."""
    others = read(result)["cores_busy_with_others"]
    return f"{others['disturbed_measurements']} of {others['measurements']}"


def starts() -> str:
    """Return the seconds to a first step, without and with compiled kernels."""
    found = read("rivals")["start_seconds_of_myowarp"]
    return "; ".join(
        f"{task} {row['fresh']:.0f} s, then {row['second']:.1f} s" for task, row in found.items()
    )


def stages_table() -> str:
    """Return what a physics step takes with the engine's code in place of one stage."""
    columns = {"all": "all of ours"}
    columns |= {f"without {stage}": f"`{stage}`" for stage in ("contact_solve", "muscle_path", "rigid_body")}
    columns |= {f"without {stage}": f"`{stage}`" for stage in ("constraint_rows", "integrate")}
    columns |= {"engine": "none of ours", "MuJoCo C": "MuJoCo C"}
    first = {row["task"]: row["microseconds"] for row in reversed(read("substep_bodies")["rows"])}
    rows = ((f"`{task}`", *(number(found[key], 3) for key in columns)) for task, found in first.items())
    return markdown(("task", *columns.values()), rows)


def memory_table() -> str:
    """Return the bytes of a world."""
    kinds = {"arrays": "arrays", "process": "process", "asked_for": "checked before building"}
    found: dict[str, dict[str, str]] = {}
    for row in read("memory")["rows"]:
        for kind in kinds:
            found.setdefault(row["family"], {})[f"{kind} {row['physics']}"] = f"{row[kind] / 1e3:.0f}"
    columns = {
        f"{kind} {preset}": f"{shown}, `{preset}`" for kind, shown in kinds.items() for preset in PRESETS
    }
    rows = ((family, *(row[key] for key in columns)) for family, row in found.items())
    return markdown(("kB a world", *columns.values()), rows)


def accuracy_table() -> str:
    """Return how far each preset is from steps of 0.1 ms."""
    rows = []
    for family, row in read("accuracy")["families"].items():
        found = {entry["preset"]: entry for entry in row["myowarp"]}
        cells = [(number(found[p]["step_ms"], 3), number(found[p]["joints_rad"])) for p in PRESETS]
        rows.append((family, *(cell for pair in cells for cell in pair)))
    heads = (head for preset in PRESETS for head in (f"`{preset}`, step [ms]", "joint error [rad]"))
    return markdown(("family", *heads), rows)


def learning_table() -> str:
    """Return the time to success beside rivals."""
    row = read("learning")["tasks"]["elbow pose"]["summary"]
    names = {"myowarp": "MyoWarp", "envpool": "EnvPool", "myosuite_async": "MyoSuite, AsyncVectorEnv"}
    keys = ("seconds", "cpu", "samples", "cores_busy_with_others")
    rows = ((shown, *(number(row[who][key], 3) for key in keys)) for who, shown in names.items())
    return markdown(("", "seconds", "CPU seconds", "samples", "cores that others used"), rows)


def speed() -> dict[str, Any]:
    """Return the fields of the page of speed."""
    policies = [row["step_ratio"] for row in read("policies")["rows"]]
    ranks = read("ranks")
    return {
        "families": steps_table("rivals"),
        "ratios": ratio_table("rivals"),
        "wide": steps_table("rivals_16_lanes"),
        "wide_ratios": ratio_table("rivals_16_lanes"),
        "bodies": steps_table("rivals_bodies"),
        "bodies_ratios": ratio_table("rivals_bodies"),
        "disturbed": disturbed("rivals"),
        "disturbed_bodies": disturbed("rivals_bodies"),
        "starts": starts(),
        "stages": stages_table(),
        "memory": memory_table(),
        "accuracy": accuracy_table(),
        "learning": learning_table(),
        "overhead": span(PERCENT * row["share"] for row in read("overhead")["rows"]),
        "policies": span(policies),
        "weak": f"{ranks['weak']:.2f}",
        "strong": f"{ranks['strong']:.2f}",
    }


# Muscles


def worst_of(test: str, key: str, elastic: bool | None = None) -> list[str]:
    """Return the worst of all models in the bench for each step [%].

    Args:
        test: `hanging`, `ball` or `sine`.
        key: Column of the measurement.
        elastic: Elastic tendons alone, rigid ones alone, or both. OpenSim has no rigid muscle of Thelen's.
    """
    found = [
        row
        for name, row in read("muscle_bench")["bench"].items()
        if name.startswith(test) and elastic in (None, "_rigid" not in name) and key in row[STEPS[0]]
    ]
    return [number(PERCENT * max(row[step][key] for row in found)) for step in STEPS]


def paths_of(*tests: str) -> list[str]:
    """Return the worst of all models on prescribed paths for each step [%], beside steps of 0.01 ms."""
    models = {m: row for m, row in read("muscle_bench")["paths"].items() if not m.endswith("_rigid")}
    return [
        number(PERCENT * max(row[step][test]["RMS"] for row in models.values() for test in tests))
        for step in STEPS
    ]


def bench_table() -> str:
    """Return errors in OpenSim's bench of muscles."""
    position, force = "position [of its range]", "force, RMS [of the peak]"
    rows = [
        ("hanging mass, position, elastic tendon", *worst_of("hanging", position, True)),
        ("the same, rigid", *worst_of("hanging", position, False)),
        ("ball, position, elastic", *worst_of("ball", position, True)),
        ("the same, rigid", *worst_of("ball", position, False)),
        ("prescribed sine, force, elastic", *worst_of("sine", force, True)),
        ("the same, rigid", *worst_of("sine", force, False)),
        ("quick release, force beside fine steps, elastic", *paths_of("quick release")),
        ("isometric, ramp and sinusoid, the same", *paths_of("isometric", "ramp", "sinusoid")),
    ]
    return markdown(("worst of the models [%]", *STEPS), rows)


def energy_table() -> str:
    """Return how far energy is off the work of the muscle."""
    felt, read_off = "work and energy, as felt", "work and energy [of all work]"
    rows = [
        (f"{shown}, {test}", *worst_of(test, key))
        for key, shown in ((felt, "force on the body"), (read_off, "force and velocity of a state"))
        for test in ("hanging", "ball")
    ]
    return markdown(("worst of the models [%]", *STEPS), rows)


def static_table() -> str:
    """Return static tendon forces beside OpenSim's."""
    rows = [
        (
            name_of(model),
            *(str(row[key]) for key in ("muscles", "samples")),
            f"{number(row['tendon force, float32']['worst'])} (`{row['tendon force, float32']['muscle']}`)",
            number(row["tendon force, float64"]["worst"]),
        )
        for model, row in read("opensim_muscles")["models"].items()
        if "tendon force, float64" in row
    ]
    return markdown(("model", "muscles", "samples", "float32, worst", "float64, worst"), rows)


def cost_table() -> str:
    """Return the cost of a muscle, and of the environment step beside MuJoCo's muscle."""
    found = read("muscles")
    steps = found["steps"]
    shown = {key: key.replace("myo", "").replace("-v1", "").replace("-v0", "") for key in steps}
    rows = [
        (
            f"`{model}`",
            number(cost),
            *(number(steps[k]["models"][model]["ratio to mujoco"], 3) for k in steps),
        )
        for model, cost in found["ns per muscle and physics step"].items()
        if model != "mujoco_readable"
    ]
    return markdown(("model", "ns a muscle and physics step", *shown.values()), rows)


def muscles() -> dict[str, Any]:
    """Return the fields of the page of muscles."""
    return {"static": static_table(), "bench": bench_table(), "energy": energy_table(), "cost": cost_table()}


# OpenSim models


def torque_table() -> str:
    """Return joint torques beside OpenSim's."""
    rows = []
    for model, row in read("opensim_muscles")["models"].items():
        torque = row["joint torque of all muscles"]
        worst = f"{number(PERCENT * torque['worst'])} (`{torque['coordinate']}`)"
        rows.append((name_of(model), str(row["muscles"]), number(PERCENT * torque["mean"]), worst))
    return markdown(("model", "muscles", "mean of coordinates [%]", "worst [%]"), rows)


def motion_table() -> str:
    """Return how far motions of half a second are off OpenSim's [degrees]."""
    kinds = {
        "opensim": "own paths, 2 ms",
        "opensim, 0.25 ms": "own paths, 0.25 ms",
        "opensim, fitted tendons": "fitted tendons, 2 ms",
        "mujoco": "`--muscle mujoco`, 2 ms",
    }
    rows = []
    for model, row in read("opensim_muscles")["models"].items():
        angles = {
            kind: [motion["angles [degrees]"] for motion in motions.values() if "angles [degrees]" in motion]
            for kind, motions in row["forward"].items()
        }
        if not angles["opensim"]:
            continue  # it slides only
        worst = max(angles["opensim"], key=lambda angle: float(angle["worst"]))
        medians = (span(a["median"] for a in angles[kind]) if angles.get(kind) else "" for kind in kinds)
        rows.append((name_of(model), *medians, f"{number(worst['worst'])} (`{worst['coordinate']}`)"))
    heads = (f"median, {shown}" for shown in kinds.values())
    return markdown(("model", *heads, "worst, own paths, 2 ms"), rows)


def paths_table() -> str:
    """Return lengths and moment arms of paths beside OpenSim's."""
    rows = [
        (
            name_of(row["model"]),
            f"{row['muscles'] * row['poses']:,}",
            *(number(row["paths"][key]["worst"]) for key in ("length_mm", "moment_arm_mm")),
            *(number(row["step"][key]["worst"]) for key in ("length_mm", "moment_arm_mm")),
            number(PERCENT * row["step"]["velocity_share"]["p9999"]),
            str(sum(row["jumps"].values())),
        )
        for row in read("opensim_paths")["models"]
    ]
    heads = ("length", "moment arm", "length in the step", "moment arm in the step")
    return markdown(("model", "paths", *(f"{h} [mm]" for h in heads), "speed [%]", "refused wraps"), rows)


def worst_speed() -> dict[str, str]:
    """Return the worst error of a path's speed in the step, and whose it is."""
    found = [(row["step"]["velocity_share"], row["model"]) for row in read("opensim_paths")["models"]]
    share, model = max(found, key=lambda one: float(one[0]["worst"]))
    where = f"{share['where']}, {name_of(model)}"
    return {"worst_speed": number(PERCENT * share["worst"]), "worst_speed_of": where}


def acceleration_table() -> str:
    """Return accelerations beside OpenSim's."""
    rows = [
        (
            name_of(model),
            *(number(PERCENT * row["step_float32"][key]) for key in ("median", "worst")),
            number(PERCENT * row["float64"]["worst"]),
        )
        for model, row in read("opensim_accelerations")["models"].items()
    ]
    return markdown(("model", "step, median [%]", "step, worst [%]", "float64, worst [%]"), rows)


def power_table() -> str:
    """Return the change of energy along OpenSim's accelerations and along ours."""
    rows = [
        (
            name_of(model),
            *(number(row["opensim_watts"][key]) for key in ("median", "worst")),
            number(row["ours_watts"]["worst"]),
            f"{number(row['most_apart'])} (`{row['where_most_apart']}`)",
        )
        for model, row in read("opensim_energy")["models"].items()
    ]
    heads = ("OpenSim, median [W]", "OpenSim, worst [W]", "ours, worst [W]")
    return markdown(("model", *heads, "accelerations most apart [rad/s² or m/s²]"), rows)


def stability_table() -> str:
    """Return faults of models as they are loaded."""
    kinds = {
        "myowarp, from key, at rest and random excitation": "10 s, at rest and excited",
        "myowarp, 16 worlds x 1,000 steps, muscles": "16 worlds, muscles",
        "myowarp, 16 worlds x 1,000 steps, muscles and motors": "16 worlds, muscles and motors",
    }
    rows = [
        (name_of(model.removesuffix(".osim")), *(str(row[k]["faults"]) if k in row else "" for k in kinds))
        for model, row in read("opensim_stability")["models"].items()
        if model.endswith(".osim")
    ]
    return markdown(("model, faults", *kinds.values()), rows)


def replica_table() -> str:
    """Return simulated seconds a second, beside OpenSim's."""
    who = ("MuJoCo C, 1 thread", "MyoWarp, 1 core", "MyoWarp, 2 cores")
    rows = []
    for model, found in json.loads(OPENSIM_SPEED.read_text())["models"].items():
        for copies in ("1", "64"):
            row = found["copies"][copies]
            over = (number(row[name]["over_opensim"]["median"], 3) for name in who)
            rows.append(
                (
                    f"{name_of(model)}, {row['OpenSim']['muscles']}",
                    number(row["OpenSim"]["rate"]["median"]),
                    *over,
                )
            )
    return markdown(("model, muscles", "OpenSim [s/s]", *(f"{name} / OpenSim" for name in who)), rows)


def loaded_table() -> str:
    """Return the speed of models with the file's own muscles and paths."""
    rows = []
    for model, row in read("opensim_loaded")["models"].items():
        over = row["MyoWarp"]
        own = number(over["rate"]["median"])
        rows.append((name_of(model), number(row["OpenSim"]["rate"]["median"]), own))
        rows[-1] += (number(over["over_opensim"]["median"]),)
    return markdown(("model", "OpenSim [s/s]", "MyoWarp [s/s]", "times OpenSim"), rows)


def opensim() -> dict[str, Any]:
    """Return the fields of the page of OpenSim models."""
    return {
        "torques": torque_table(),
        "motions": motion_table(),
        "paths": paths_table(),
        **worst_speed(),
        "accelerations": acceleration_table(),
        "power": power_table(),
        "stability": stability_table(),
        "replicas": replica_table(),
        "loaded": loaded_table(),
    }


# Recorded motions


def deviation_table() -> str:
    """Return the greatest deviations of recorded motions from OpenSim's tools."""
    models = read("opensim_motion")["models"]
    keys = ("factors", "angles, deg", "marker errors, mm", "moments / peak", "activations, worst")
    keys += ("forces / peak", "reaction forces / peak", "reaction moments / peak")
    rows = ((key, *(number(row[key]) if key in row else "–" for row in models)) for key in keys)
    return markdown(("greatest deviation", *(row["model"] for row in models)), rows)


def rate_table() -> str:
    """Return frames a second of recorded motions."""
    found, rows = read("motion"), []
    for key in ("inverse kinematics", "inverse dynamics", "paths and static optimisation"):
        theirs, ours = found["opensim"][key], found["myowarp"][key]["wall"]
        rows.append((key, number(1e3 * theirs), number(1.0 / ours), number(theirs / ours)))
    return markdown(("", "OpenSim 4.6 [ms a frame]", "MyoWarp [frames/s]", "times as many"), rows)


def tracking_table() -> str:
    """Return the residuals of tracking beside CMC's."""
    rows = [
        (name, *(number(row[key], 3) for key in ("cmc_rms", "rms", "cmc_peak", "peak")))
        for name, row in read("opensim_tracking")["residuals"].items()
    ]
    return markdown(("residual [N, N m]", "CMC, RMS", "ours, RMS", "CMC, peak", "ours, peak"), rows)


def motion() -> dict[str, Any]:
    """Return the fields of the page of recorded motions."""
    tracking = read("opensim_tracking")
    off = {
        key: max(tracking[key].items(), key=lambda item: float(item[1]))
        for key in ("off, deg", "off of CMC, deg")
    }
    shown = {key: f"{number(value)}° (`{name}`)" for key, (name, value) in off.items()}
    return {
        "deviations": deviation_table(),
        "rates": rate_table(),
        "tracking": tracking_table(),
        "off": shown["off, deg"],
        "off_cmc": shown["off of CMC, deg"],
    }


FIELDS: dict[str, Callable[[], dict[str, Any]]] = {
    "speed": speed,
    "muscles": muscles,
    "opensim": opensim,
    "motion": motion,
}


def page(name: str) -> str:
    """Return a page."""
    title, _, text = (TEXTS / f"{name}.md").read_text().partition("\n")
    return f"{title}\n\n{NOTE}\n{text.format(**FIELDS[name]())}"


if __name__ == "__main__":
    PAGES.mkdir(exist_ok=True)
    for name in FIELDS:
        with in_place(PAGES / f"{name}.md") as scratch:
            scratch.write_text(page(name))
