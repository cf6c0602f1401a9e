"""Record what OpenSim's tools make of an arm with springs, limits, bushings, ligaments and motors.

    python tests/data/record_opensim_beside.py -o tests/data/opensim/beside.json

needs an interpreter with `opensim` (4.6) and numpy only; nothing of ours is imported. Each variant is arm26
with the forces of `FORCES` that it names, put first into its set of forces. A number for each frame and
coordinate, SI and rad:

    coordinates, time, values          the motion, a sine of each coordinate
    forces                             XML of each force, by name
    moments                            by variant, names joined with +: inverse dynamics, without muscles
    excluded                           the same of one variant, by what `forces_to_exclude` has; with "load+"
                                       in front there is an external load, too
    static                             controls and forces of actuators, by name, from static optimisation
    reactions                          force, moment and point of each joint, under the forces in `static`
"""

import argparse
import json
import os
import tempfile
from pathlib import Path

import numpy as np
import opensim
from record_opensim_motion import columns, push, table

ARM = Path(__file__).parent.resolve() / "osim/arm26.osim"
COORDINATES = ["r_shoulder_elev", "r_elbow_flex"]
JOINTS = ["r_shoulder", "r_elbow"]
TIME = np.arange(41) / 40.0
VALUES = np.stack([0.3 + 0.3 * np.sin(4.0 * TIME), 1.2 + 0.6 * np.cos(4.0 * TIME)], axis=1)
PLACE = '<ForceSet name="forceset">\n\t\t\t<objects>'

BODIES = """<socket_frame1>{0}</socket_frame1><socket_frame2>{1}</socket_frame2><frames>
<PhysicalOffsetFrame name="{0}"><socket_parent>/bodyset/{0}</socket_parent><translation>{2}</translation>
<orientation>{3}</orientation></PhysicalOffsetFrame>
<PhysicalOffsetFrame name="{1}"><socket_parent>/bodyset/{1}</socket_parent><translation>{4}</translation>
<orientation>{5}</orientation></PhysicalOffsetFrame></frames>"""
PATH = """<GeometryPath name="path"><PathPointSet><objects>
<PathPoint name="a"><socket_parent_frame>/bodyset/base</socket_parent_frame>
<location>0.02 0.03 0.12</location></PathPoint><PathPoint name="b">
<socket_parent_frame>/bodyset/r_humerus</socket_parent_frame><location>0.025 -0.22 0.01</location></PathPoint>
<PathPoint name="c"><socket_parent_frame>/bodyset/r_ulna_radius_hand</socket_parent_frame>
<location>0.01 -0.06 0.02</location></PathPoint></objects></PathPointSet></GeometryPath>"""
FORCES = {
    "spring": """<SpringGeneralizedForce name="spring"><coordinate>r_elbow_flex</coordinate>
<stiffness>5</stiffness><rest_length>0.3</rest_length><viscosity>0.5</viscosity></SpringGeneralizedForce>""",
    "limit": """<CoordinateLimitForce name="limit"><coordinate>r_elbow_flex</coordinate>
<upper_stiffness>2</upper_stiffness><upper_limit>90</upper_limit><lower_stiffness>1</lower_stiffness>
<lower_limit>30</lower_limit><damping>0.01</damping><transition>20</transition></CoordinateLimitForce>""",
    "bushing": '<BushingForce name="bushing">'
    + BODIES.format(
        "base", "r_ulna_radius_hand", "0.01 -0.05 0.15", "0.1 -0.2 0.3", "0.02 -0.03 0.01", "-0.2 0.1 0.2"
    )
    + """<rotational_stiffness>4 3 5</rotational_stiffness>
<translational_stiffness>40 20 30</translational_stiffness>
<rotational_damping>0.2 0.1 0.3</rotational_damping>
<translational_damping>2 3 1</translational_damping></BushingForce>""",
    "band": f"""<PathSpring name="band">{PATH}<resting_length>0.3</resting_length><stiffness>500</stiffness>
<dissipation>0.1</dissipation></PathSpring>""",
    "ligament": f"""<Ligament name="ligament">{PATH}<resting_length>0.3</resting_length>
<pcsa_force>60</pcsa_force><force_length_curve><SimmSpline>
<x>0.9 1 1.02 1.05 1.1 1.3</x><y>0 0 0.1 0.5 1.2 4</y></SimmSpline></force_length_curve></Ligament>""",
    "blankevoort": f"""<Blankevoort1991Ligament name="blankevoort">{PATH}<slack_length>0.3</slack_length>
<linear_stiffness>300</linear_stiffness><transition_strain>0.06</transition_strain>
<damping_coefficient>0.003</damping_coefficient></Blankevoort1991Ligament>""",
    "expression": """<ExpressionBasedCoordinateForce name="expression"><coordinate>r_elbow_flex</coordinate>
<expression>-3*q-0.4*qdot</expression></ExpressionBasedCoordinateForce>""",
    "cuff": '<FunctionBasedBushingForce name="cuff">'
    + BODIES.format(
        "base", "r_ulna_radius_hand", "0.01 -0.05 0.15", "0.1 -0.2 0.3", "0.02 -0.03 0.01", "-0.2 0.1 0.2"
    )
    + """<m_z_theta_z_function><PolynomialFunction><coefficients>2 0.5 3 0.1</coefficients>
</PolynomialFunction></m_z_theta_z_function><f_y_delta_y_function><LinearFunction>
<coefficients>90 2</coefficients></LinearFunction></f_y_delta_y_function>
<rotational_damping>0.2 0.1 0.3</rotational_damping>
<translational_damping>2 3 1</translational_damping></FunctionBasedBushingForce>""",
    "strap": '<ExpressionBasedBushingForce name="strap">'
    + BODIES.format(
        "base", "r_ulna_radius_hand", "0.01 -0.05 0.15", "0.1 -0.2 0.3", "0.02 -0.03 0.01", "-0.2 0.1 0.2"
    )
    + """<Mz_expression>2*sin(theta_z)+exp(theta_x)-1</Mz_expression>
<Fx_expression>50*delta_x</Fx_expression><Fy_expression>80*delta_y+30*delta_x*theta_z</Fy_expression>
<rotational_damping>0.2 0.1 0.3</rotational_damping>
<translational_damping>2 3 1</translational_damping></ExpressionBasedBushingForce>""",
    "cord": f"""<ExpressionBasedPathForce name="cord">{PATH}<resting_length>0.3</resting_length>
<expression>900*s*(1+0.3*ldot)+50*s^2</expression></ExpressionBasedPathForce>""",
    "line": """<PointToPointSpring name="line"><socket_body1>/bodyset/base</socket_body1>
<socket_body2>/bodyset/r_ulna_radius_hand</socket_body2><point1>0.05 0.02 0.01</point1>
<point2>0.03 -0.1 0.02</point2><stiffness>200</stiffness><rest_length>0.2</rest_length>
</PointToPointSpring>""",
    "tube": """<ExpressionBasedPointToPointForce name="tube"><body1>base</body1>
<body2>r_ulna_radius_hand</body2><point1>0.03 -0.02 0.01</point1><point2>0.03 -0.1 0.02</point2>
<expression>120*(d-0.15)^2+15*ddot</expression></ExpressionBasedPointToPointForce>""",
    "wind": """<PrescribedForce name="wind"><socket_frame>/bodyset/r_ulna_radius_hand</socket_frame>
<pointIsGlobal>false</pointIsGlobal><forceIsGlobal>true</forceIsGlobal>
<FunctionSet name="forceFunctions"><objects>
<Constant><value>4</value></Constant><Sine><amplitude>9</amplitude><omega>6</omega><phase>0.3</phase>
<offset>2</offset></Sine><Constant><value>-3</value></Constant></objects></FunctionSet>
<FunctionSet name="pointFunctions"><objects><Constant><value>0.02</value></Constant>
<Constant><value>-0.2</value></Constant><LinearFunction><coefficients>0.1 0.02</coefficients>
</LinearFunction></objects></FunctionSet>
<FunctionSet name="torqueFunctions"><objects><Constant><value>0.5</value></Constant>
<Constant><value>0.2</value></Constant><Constant><value>-1</value></Constant></objects></FunctionSet>
</PrescribedForce>""",
    "motor": """<CoordinateActuator name="motor"><min_control>-0.4</min_control>
<max_control>0.02</max_control><coordinate>r_elbow_flex</coordinate><optimal_force>5</optimal_force></CoordinateActuator>""",
    "cable": f"""<PathActuator name="cable"><min_control>0</min_control><max_control>1</max_control>
{PATH}<optimal_force>40</optimal_force></PathActuator>""",
    "twist": """<TorqueActuator name="twist"><min_control>-inf</min_control><max_control>inf</max_control>
<bodyA>r_humerus</bodyA><bodyB>base</bodyB><torque_is_global>true</torque_is_global><axis>0.1 0.2 1</axis>
<optimal_force>20</optimal_force></TorqueActuator>""",
    "thrust": """<PointActuator name="thrust"><min_control>-1</min_control><max_control>1</max_control>
<body>r_ulna_radius_hand</body><point>0.01 -0.2 0.03</point><point_is_global>false</point_is_global>
<direction>1 0.3 0.1</direction><force_is_global>false</force_is_global><optimal_force>15</optimal_force>
</PointActuator>""",
}
ALONE = (
    *("spring", "limit", "bushing", "cuff", "strap", "band", "cord", "ligament", "blankevoort"),
    *("line", "tube", "expression", "wind", "motor"),
)
TOGETHER = ("spring", "limit", "bushing", "band")
EXCLUDED = ("Muscles", "muscles+spring", "Muscles+limit+band", "Muscles+nobody", "ALL", "actuators")
DRIVEN = ("spring", "bushing", "band", "motor", "cable", "twist", "thrust")
SHOWN = slice(4, 37, 8)
"""Frames of static optimisation and reactions that are kept."""


def variant(names):
    """Write arm.osim."""
    text = ARM.read_text()
    assert PLACE in text
    Path("arm.osim").write_text(text.replace(PLACE, PLACE + "".join(FORCES[name] for name in names)))


def moments(excluded, load=False):
    """Return inverse dynamics of arm.osim."""
    tool = opensim.InverseDynamicsTool()
    tool.setModelFileName("arm.osim")
    tool.setCoordinatesFileName("motion.mot")
    tool.setExternalLoadsFileName("push.xml" if load else "")
    tool.setLowpassCutoffFrequency(-1.0)
    tool.setStartTime(TIME[0])
    tool.setEndTime(TIME[-1])
    names = opensim.ArrayStr()
    for name in excluded:
        names.append(name)
    tool.setExcludedForces(names)
    tool.setResultsDir(".")
    tool.setOutputGenForceFileName("moments.sto")
    tool.run()
    return columns(Path("moments.sto"), [f"{name}_moment" for name in COORDINATES])[1]


def analyze(name, analysis):
    """Run an analysis of motion.mot on arm.osim."""
    tool = opensim.AnalyzeTool()
    tool.setName(name)
    tool.setModelFilename("arm.osim")
    tool.setCoordinatesFileName("motion.mot")
    tool.setLowpassCutoffFrequency(-1.0)
    tool.setStartTime(TIME[0])
    tool.setFinalTime(TIME[-1])
    tool.setResultsDir(".")
    analysis.setStartTime(TIME[0])
    analysis.setEndTime(TIME[-1])
    tool.updAnalysisSet().cloneAndAppend(analysis)
    tool.printToXML(f"{name}.xml")
    opensim.AnalyzeTool(f"{name}.xml").run()


def driven():
    """Return what static optimisation and joint reactions of arm.osim are."""
    analysis = opensim.StaticOptimization()
    analysis.setUseModelForceSet(True)
    analysis.setActivationExponent(2.0)
    analysis.setUseMusclePhysiology(True)
    analysis.setConvergenceCriterion(1e-10)
    analysis.setMaxIterations(2000)
    analyze("so", analysis)
    model = opensim.Model("arm.osim")
    actuators = model.getActuators()
    names = [actuators.get(i).getName() for i in range(actuators.getSize())]
    found = {}
    for what, file in (("controls", "activation"), ("forces", "force")):
        time, values, _ = columns(Path(f"so_StaticOptimization_{file}.sto"), names)
        found[what] = dict(zip(names, values[SHOWN].T.tolist(), strict=True))
    # JointReaction reads as many columns as there are actuators, so that no other one may come before.
    table(Path("forces.sto"), "forces", names, time, values)
    analysis = opensim.JointReaction()
    analysis.setForcesFileName("forces.sto")
    analyze("jr", analysis)
    labels = [f"{joint}_on_{child}_in_ground_{part}{axis}" for joint, child in
              zip(JOINTS, ("r_humerus", "r_ulna_radius_hand"), strict=True)
              for part in "fmp" for axis in "xyz"]  # fmt: skip
    reactions = columns(next(Path().glob("jr*ReactionLoads*")), labels)[1][SHOWN]
    return found, reactions.reshape(len(reactions), len(JOINTS), 9)


def main():
    """Record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    output = parser.parse_args().output.resolve()
    opensim.Logger.setLevelString("Error")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        table(Path("motion.mot"), "Coordinates", COORDINATES, TIME, VALUES)
        force = np.tile([5.0, -12.0, 1.0], (len(TIME), 1))
        push("r_ulna_radius_hand", TIME, force, np.tile([0.2, -0.3, 0.1], (len(TIME), 1)))
        found = {}
        for names in ((), *((name,) for name in ALONE), TOGETHER):
            variant(names)
            found["+".join(names)] = moments(["Muscles"])
        excluded = {}
        for words in EXCLUDED:
            excluded[words] = moments(words.split("+"))
            excluded[f"load+{words}"] = moments(words.split("+"), load=True)
        variant(DRIVEN)
        static, reactions = driven()

    def listed(array):
        return np.round(array, 10).tolist()

    result = {
        "opensim": opensim.GetVersion(),
        "place": PLACE,
        "forces": FORCES,
        "coordinates": COORDINATES,
        "time": listed(TIME),
        "values": listed(VALUES),
        "moments": {name: listed(array) for name, array in found.items()},
        "load": {"body": "r_ulna_radius_hand", "force": [5.0, -12.0, 1.0], "point": [0.2, -0.3, 0.1]},
        "excluded of": "+".join(TOGETHER),
        "excluded": {name: listed(array) for name, array in excluded.items()},
        "driven": "+".join(DRIVEN),
        "frames": list(range(len(TIME)))[SHOWN],
        "static": static,
        "reactions": listed(reactions),
    }
    output.write_text(json.dumps(result, indent=1).replace("\n   ", " ") + "\n")
    for name, array in found.items():
        print(f"{name:30s}", np.abs(array - found[""]).max(axis=0).round(4))
    for name, array in excluded.items():
        print(f"{name:30s}", array[10].round(4))
    for name, control in static["controls"].items():
        print(name, np.round(control, 3))


if __name__ == "__main__":
    main()
