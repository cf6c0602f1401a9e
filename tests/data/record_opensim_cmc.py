"""Write what OpenSim's CMC and RRA write of a motion of arm26: angles, states, controls, forces.

    python tests/data/record_opensim_cmc.py -o tests/data/opensim/cmc

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. The shoulder is to be
at 0.3 + 0.3 sin(4 t), the elbow at 1.2 + 0.4 cos(4 t). CMC runs over 0.1 s with muscles and reserves
of 1 N m, RRA over the same with motors of 20 N m in place of muscles. Kept are the files of `KEPT`, every
tenth row of those that are long, with the numbers as OpenSim writes them.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import opensim

ARM = Path(__file__).parent / "osim/arm26.osim"
COORDINATES = ("r_shoulder_elev", "r_elbow_flex")
BEGIN, END = 0.1, 0.2
KEPT = ("Kinematics_q.sto", "Kinematics_u.sto", "states.sto", "controls.sto", "controls.xml",
        "Actuation_force.sto")  # fmt: skip
EVERY = 10

TASK = """<CMC_Joint name="{0}"><on>true</on><weight>1 1 1</weight><active>true false false</active>
<kp>100 1 1</kp><kv>20 1 1</kv><ka>1 1 1</ka><coordinate>{0}</coordinate></CMC_Joint>"""
MOTOR = """<CoordinateActuator name="{0}_motor"><coordinate>{0}</coordinate><min_control>-100</min_control>
<max_control>100</max_control><optimal_force>{1}</optimal_force></CoordinateActuator>"""
TOOL = """<OpenSimDocument Version="40000"><{tool} name="{name}"><model_file>{model}</model_file>
<replace_force_set>{replace}</replace_force_set><force_set_files>{forces}</force_set_files>
<results_directory>{results}</results_directory>
<initial_time>{begin}</initial_time><final_time>{end}</final_time>
<solve_for_equilibrium_for_auxiliary_states>true</solve_for_equilibrium_for_auxiliary_states>
<AnalysisSet name="Analyses"><objects>
<Kinematics name="Kinematics"><step_interval>1</step_interval></Kinematics>
<Actuation name="Actuation"><step_interval>1</step_interval></Actuation></objects></AnalysisSet>
<desired_kinematics_file>{wanted}</desired_kinematics_file><task_set_file>{tasks}</task_set_file>
<lowpass_cutoff_frequency>-1</lowpass_cutoff_frequency>
<optimizer_algorithm>ipopt</optimizer_algorithm>{more}</{tool}></OpenSimDocument>"""
CMC = (
    "<cmc_time_window>0.01</cmc_time_window><use_fast_optimization_target>true</use_fast_optimization_target>"
)
RRA = """<adjust_com_to_reduce_residuals>false</adjust_com_to_reduce_residuals>
<output_model_file>{}/adjusted.osim</output_model_file>"""


def written(folder, file, text):
    """Write a document; returns its path."""
    path = folder / file
    path.write_text(text)
    return path


def run(folder, tool, name, reserve, more, replace):
    """Run one of the tools in a folder; returns its results."""
    document = '<OpenSimDocument Version="40000">{}</OpenSimDocument>'
    tasks = "".join(map(TASK.format, COORDINATES))
    motors = "".join(MOTOR.format(one, reserve) for one in COORDINATES)
    text = TOOL.format(
        tool=tool,
        name=name,
        model=ARM,
        replace=str(replace).lower(),
        forces=written(
            folder,
            f"{name}_motors.xml",
            document.format(f'<ForceSet name="motors"><objects>{motors}</objects></ForceSet>'),
        ),
        results=folder / name,
        begin=BEGIN,
        end=END,
        wanted=folder / "wanted.mot",
        tasks=written(
            folder,
            f"{name}_tasks.xml",
            document.format(f'<CMC_TaskSet name="tasks"><objects>{tasks}</objects></CMC_TaskSet>'),
        ),
        more=more,
    )
    setup = written(folder, f"{name}.xml", text)
    made = opensim.CMCTool(str(setup)) if tool == "CMCTool" else opensim.RRATool(str(setup))
    if not made.run():
        raise SystemExit(f"{tool} failed")
    return folder / name


def thinned(text):
    """Return a table with every tenth row, and the last one."""
    head, end, rows = text.partition("endheader\n")
    labels, *rows = rows.splitlines()
    kept = rows[:-1:EVERY] + rows[-1:] if len(rows) > 3 * EVERY else rows
    head = "\n".join(f"nRows={len(kept)}" if line.startswith("nRows") else line for line in head.splitlines())
    return "\n".join([head, end.strip(), labels, *kept, ""])


def main():
    """Run both, and keep their files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    opensim.Logger.setLevelString("Error")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        time = np.linspace(0.0, 0.4, 81)
        angles = np.stack([0.3 + 0.3 * np.sin(4.0 * time), 1.2 + 0.4 * np.cos(4.0 * time)], axis=1)
        rows = "\n".join("\t".join(map(repr, map(float, row))) for row in np.column_stack([time, angles]))
        written(
            folder,
            "wanted.mot",
            f"Coordinates\nversion=1\nnRows={len(time)}\nnColumns=3\ninDegrees=no\nendheader\n"
            f"time\t{COORDINATES[0]}\t{COORDINATES[1]}\n{rows}\n",
        )
        for results in (
            run(folder, "CMCTool", "cmc", 1.0, CMC, False),
            run(folder, "RRATool", "rra", 20.0, RRA.format(folder), True),
        ):
            for ending in KEPT:
                for found in results.glob(f"*_{ending}"):
                    text = found.read_text()
                    (output / found.name).write_text(text if ending.endswith(".xml") else thinned(text))


if __name__ == "__main__":
    main()
