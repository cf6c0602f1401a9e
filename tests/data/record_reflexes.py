"""Record what MyoSuite 2.12.2's reflex controller tells the muscles, for random walks of its senses.

    pip download --no-deps myosuite==2.12.2
    python tests/data/record_reflexes.py --wheel myosuite-2.12.2-py3-none-any.whl

Its parameter `BFSH_8_PG` is drawn equal to `BFSH_8_DG`, whose value it takes.
"""

import argparse
import json
import zipfile
from pathlib import Path

import numpy as np

FILE = "myosuite/agents/baseline_Reflex/reflexCtr.py"
OUT = Path(__file__).parent / "reflexes.npz"
WALKS, STEPS = 3, 120
LEGS = ("r_leg", "l_leg")
TRUNK = {"pitch": (0.0, 0.2), "pitch_rate": (0.0, 1.0), "roll": (0.0, 0.1), "roll_rate": (0.0, 1.0)}
TRUNK |= {"speed_ahead": (1.2, 0.4), "speed_left": (0.0, 0.2)}
PAIRS = {"load": (0.3, 0.5), "hip": (3.0, 0.5), "hip_rate": (0.0, 3.0), "knee": (2.6, 0.5)}
PAIRS |= {"knee_rate": (0.0, 4.0), "ankle": (1.5, 0.3), "spread": (1.5, 0.2), "rf_force": (0.2, 0.2)}
PAIRS |= {"vas_force": (0.3, 0.3), "gas_force": (0.3, 0.3), "sol_force": (0.4, 0.3)}


def walk(rng, size, steps, mean, spread):
    """Return a smooth random walk around a mean, shape (steps, size)."""
    value, rows = rng.normal(size=size), []
    for _ in range(steps):
        value = 0.9 * value + 0.436 * rng.normal(size=size)
        rows.append(mean + spread * value)
    return np.array(rows)


def sensed(row):
    """Return senses under MyoSuite's names."""
    load = row["load"]
    data = {
        "body": {
            "theta": [row["roll"][0], row["pitch"][0]],
            "dtheta": [row["roll_rate"][0], row["pitch_rate"][0]],
            "d_pos": [row["speed_ahead"][0], row["speed_left"][0]],
        }
    }
    for i, leg in enumerate(LEGS):
        data[leg] = {
            "load_ipsi": load[i],
            "load_contra": load[1 - i],
            "contact_ipsi": int(load[i] > 0.1),
            "contact_contra": int(load[1 - i] > 0.1),
            "phi_hip": row["hip"][i],
            "phi_knee": row["knee"][i],
            "phi_ankle": row["ankle"][i],
            "dphi_knee": row["knee_rate"][i],
            "alpha": row["hip"][i] - 0.5 * row["knee"][i],
            "dalpha": row["hip_rate"][i] - 0.5 * row["knee_rate"][i],
            "alpha_f": row["spread"][i],
        } | {f"F_{name.upper()}": row[f"{name}_force"][i] for name in ("rf", "vas", "gas", "sol")}
    return data


def controller(wheel):
    """Return MyoSuite's class."""
    space = {"__name__": "reflexCtr"}
    exec(compile(zipfile.ZipFile(wheel).read(FILE), FILE, "exec"), space)
    return space["LocoCtrl"]


def main():
    """Record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", required=True)
    kind, rng = controller(parser.parse_args().wheel), np.random.default_rng(0)
    keys, arrays = list(kind.cp_keys), {name: [] for name in (*TRUNK, *PAIRS, "parameter", "stimulation")}
    for _ in range(WALKS):
        parameters = rng.uniform(0.2, 2.0, len(keys))
        parameters[keys.index("BFSH_8_PG")] = parameters[keys.index("BFSH_8_DG")]
        acts, told = kind(0.01, control_dimension=3, params=parameters), []
        rows = {name: walk(rng, 1, STEPS, *of) for name, of in TRUNK.items()}
        rows |= {name: walk(rng, 2, STEPS, *of) for name, of in PAIRS.items()}
        rows["load"] = rows["load"].clip(0.0)
        for step in range(STEPS):
            acts.update(sensed({name: values[step] for name, values in rows.items()}))
            told.append([[acts.stim[leg][group] for group in kind.m_keys] for leg in LEGS])
        for name, values in (rows | {"parameter": parameters, "stimulation": np.array(told)}).items():
            arrays[name].append(values)
    meta = {"source": f"MyoSuite 2.12.2, {FILE}", "keys": keys, "groups": list(kind.m_keys)}
    np.savez_compressed(OUT, meta=json.dumps(meta), **{name: np.array(rows) for name, rows in arrays.items()})


if __name__ == "__main__":
    main()
