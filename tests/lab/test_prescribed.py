"""Controllers of a model as a policy, by closed forms of their functions; XML as OpenSim 4.6 writes it."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from myowarp.apps.policies.prescribed import prescribed

ARM = (Path(__file__).parents[1] / "data/osim/arm26.osim").read_text()
SPEC = SimpleNamespace(physics_dt=0.002, num_substeps=5, horizon=100)
STEP = """<StepFunction><transition_start_time>0.2</transition_start_time>
<transition_end_time>0.6</transition_end_time><start_value>0.1</start_value><end_value>0.8</end_value>
</StepFunction>"""
SINE = "<Sine><amplitude>0.3</amplitude><omega>7</omega><phase>0.2</phase><offset>0.4</offset></Sine>"
CONTROLLERS = """<ControllerSet name="controllerset"><objects>
<PrescribedController name="one"><socket_actuators>/forceset/BRA /forceset/TRIlong</socket_actuators>
<FunctionSet name="ControlFunctions"><objects>{first}{second}</objects></FunctionSet></PrescribedController>
<PrescribedController name="two"><enabled>{on}</enabled><actuator_list>BRA</actuator_list>
<ControlFunctions name="ControlFunctions"><objects><Constant name="BRA"><value>0.05</value></Constant>
</objects></ControlFunctions></PrescribedController></objects></ControllerSet>"""


def controlled(folder, **parts):
    """Write the arm with controllers."""
    path = folder / "arm.osim"
    text = CONTROLLERS.format(**{"first": STEP, "second": SINE, "on": "true"} | parts)
    path.write_text(ARM.replace("<ForceSet", text + "<ForceSet", 1))
    return path


@pytest.mark.parametrize("on", ["true", "false"])
def test_controls_are_the_functions_of_time(on, tmp_path):
    found = prescribed(controlled(tmp_path, on=on), SPEC)
    t = np.clip((found.time - 0.2) / 0.4, 0.0, 1.0)
    step = 0.1 + 0.7 * t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    bra, tri, others = (found.values[:, [found.labels.index(name)]] for name in ("BRA", "TRIlong", "BIClong"))
    np.testing.assert_allclose(found.time[-1], 1.01)
    np.testing.assert_allclose(bra[:, 0], step + (0.05 if on == "true" else 0.0), rtol=1e-12)
    np.testing.assert_allclose(tri[:, 0], 0.4 + 0.3 * np.sin(7.0 * found.time + 0.2), rtol=1e-12)
    assert not others.any()


def test_a_file_of_controls_plays(tmp_path):
    (tmp_path / "controls.sto").write_text(
        "controls\nversion=1\nnRows=3\nnColumns=2\ninDegrees=no\nendheader\ntime\t/forceset/BRA\n"
        "0\t0.1\n0.5\t0.6\n2\t0.3\n"
    )
    path = controlled(tmp_path, first="", second="")
    path.write_text(path.read_text().replace("</FunctionSet></Pre", "</FunctionSet><controls_file>"
                                             "controls.sto</controls_file></Pre"))  # fmt: skip
    found = prescribed(path, SPEC)
    bra = found.values[:, found.labels.index("BRA")] - 0.05
    np.testing.assert_allclose(bra, np.interp(found.time, [0.0, 0.5, 2.0], [0.1, 0.6, 0.3]), rtol=1e-12)


def arm_with(folder, controllers, more=""):
    """Write the arm with a set of controllers, and components beside them."""
    path, text = folder / "arm.osim", ARM
    for tag, objects in (("ControllerSet", controllers), ("ComponentSet", more)):
        text = re.sub(f"<{tag} .*?</{tag}>", f"<{tag}><objects>{objects}</objects></{tag}>", text, flags=re.S)
    path.write_text(text)
    return path


REFLEX = """<ToyReflexController name="reflex"><socket_actuators>/forceset/BRA</socket_actuators>
<gain>0.7</gain></ToyReflexController>"""
STEADY = """<PrescribedController name="one"><socket_actuators>/forceset/BRA</socket_actuators>
<ControlFunctions><objects><Constant name="BRA"><value>0.05</value></Constant></objects></ControlFunctions>
</PrescribedController>"""


@pytest.mark.parametrize(
    ("controllers", "said"),
    [
        ("", "that is on; the model has none"),
        (REFLEX, r"ToyReflexController /controllerset/reflex; a reflex is the condition "
                 r"'stretch_reflex\(gain=\{'BRA': 0.7\}\)'"),
        ('<MyController name="mine"/>', "the model has MyController /controllerset/mine$"),
    ],
)  # fmt: skip
def test_a_model_without_controllers_that_act_is_one_sentence(controllers, said, tmp_path):
    with pytest.raises(ValueError, match=f"needs a PrescribedController or .*{said}"):
        prescribed(arm_with(tmp_path, controllers), SPEC)


CONSTANT = '<Constant name="{}"><value>{}</value></Constant>'
LISTED = """<PrescribedController name="one"><actuator_list>{}</actuator_list><FunctionSet
name="ControlFunctions"><objects>{}</objects></FunctionSet></PrescribedController>"""
EVERY = ("TRIlong", "TRIlat", "TRImed", "BIClong", "BICshort", "BRA")


@pytest.mark.parametrize(
    ("names", "functions", "said"),
    [
        ("BRA TRIlat", (("TRIlat", 0.3), ("BRA", 0.2)), "'TRIlat'> has the place of 'BRA'; put functions in"),
        ("BRA TRIlat", (("BRA", 0.3),), "needs a function for each of its 2 actuators, got 1"),
        ("BRAx", (("BRAx", 0.3),), "drives the actuator 'BRAx', which the model does not have"),
    ],
)
def test_functions_that_are_of_no_actuator_are_refused(names, functions, said, tmp_path):
    """OpenSim 4.6 takes those of other places as they stand, and refuses the others."""
    text = LISTED.format(names, "".join(CONSTANT.format(*one) for one in functions))
    with pytest.raises(ValueError, match=said):
        prescribed(arm_with(tmp_path, text), SPEC)


def test_functions_of_unknown_classes_are_refused(tmp_path):
    with pytest.raises(NotImplementedError, match="<Wave name='BRA'> is no supported function"):
        prescribed(arm_with(tmp_path, LISTED.format("BRA", '<Wave name="BRA"/>')), SPEC)


def test_functions_go_by_their_places(tmp_path):
    """In one case they are all actuators'; else they have names of nothing."""
    levels = [0.1 * (number + 1) for number in range(len(EVERY))]
    named = "".join(CONSTANT.format(f"/forceset/{name}", x) for name, x in zip(EVERY, levels, strict=True))
    found = prescribed(arm_with(tmp_path, LISTED.format("ALL", named)), SPEC)
    assert found.values[0].tolist() == [levels[EVERY.index(name)] for name in found.labels]
    other = LISTED.format("BRA BIClong", CONSTANT.format("a", 0.3) + CONSTANT.format("BIClong", 0.2))
    found = prescribed(arm_with(tmp_path, other), SPEC)
    assert [found.values[0, found.labels.index(name)] for name in ("BRA", "BIClong")] == [0.3, 0.2]


def test_controllers_beside_those_that_act_are_named(tmp_path, caplog):
    found = prescribed(arm_with(tmp_path, STEADY + REFLEX), SPEC)
    assert (found.values[:, found.labels.index("BRA")] == 0.05).all()
    assert (
        "controls of arm.osim are without ToyReflexController /controllerset/reflex; a reflex" in caplog.text
    )


NODES = ((0.1, 0.2), (0.4, 0.8), (0.7, 0.5))


@pytest.mark.parametrize(
    ("steps", "extrapolate", "law"),
    [
        ("false", "false", lambda t: np.interp(t, *zip(*NODES, strict=True))),
        ("false", "true", lambda t: np.where(t < 0.4, 0.2 + 2.0 * (t - 0.1), 0.8 - (t - 0.4))),
        ("true", "false", lambda t: np.select([t <= 0.1, t <= 0.4], [0.2, 0.8], 0.5)),
    ],
)
def test_a_set_of_controls_plays(steps, extrapolate, law, tmp_path):
    """Of CMC's tool; with `use_steps` a value holds up to its node."""
    nodes = "".join(f"<ControlLinearNode><t>{t}</t><value>{v}</value></ControlLinearNode>" for t, v in NODES)
    (tmp_path / "controls.xml").write_text(
        f'<OpenSimDocument Version="40000"><ControlSet><objects><ControlLinear name="BRA.excitation">'
        f"<use_steps>{steps}</use_steps><extrapolate>{extrapolate}</extrapolate><x_nodes>{nodes}</x_nodes>"
        "</ControlLinear></objects></ControlSet></OpenSimDocument>"
    )
    controller = "<ControlSetController><controls_file>controls.xml</controls_file></ControlSetController>"
    found = prescribed(arm_with(tmp_path, controller), SPEC)
    np.testing.assert_allclose(
        found.values[:, found.labels.index("BRA")], law(found.time), rtol=1e-12, atol=1e-12
    )


def of_inputs(folder, controller, inputs="/componentset/inputs|column:a /componentset/inputs|column:b"):
    """Return what a controller makes of the columns of a table."""
    (folder / "inputs.sto").write_text(
        "inputs\nversion=1\nnRows=2\nnColumns=3\ninDegrees=no\nendheader\n"
        "time\ta\tb\n0\t0.1\t0.5\n1\t0.4\t0.3\n"
    )
    source = '<TableSource__double_ name="inputs"><filename>inputs.sto</filename></TableSource__double_>'
    return prescribed(arm_with(folder, controller.format(inputs=inputs), source), SPEC)


SYNERGIES = """<SynergyController name="synergies"><socket_actuators>/forceset/BRA /forceset/TRIlong
</socket_actuators><input_controls>{inputs}</input_controls><synergy_vectors>
<SynergyVector><synergy_weights>0.2 0.1</synergy_weights></SynergyVector>
<SynergyVector><synergy_weights>0.1 0.5</synergy_weights></SynergyVector></synergy_vectors>
</SynergyController>"""


def test_synergies_spread_their_inputs(tmp_path):
    """OpenSim 4.6, of muscles with the same weights, has controls of 0.084 and 0.2355 at 0.35 s."""
    found = of_inputs(tmp_path, SYNERGIES)
    t = np.minimum(found.time, 1.0)
    a, b = 0.1 + 0.3 * t, 0.5 - 0.2 * t
    for name, law, live in (("BRA", 0.2 * a + 0.1 * b, 0.084), ("TRIlong", 0.1 * a + 0.5 * b, 0.2355)):
        values = found.values[:, found.labels.index(name)]
        np.testing.assert_allclose(values, law, rtol=1e-12)
        assert np.interp(0.35, found.time, values) == pytest.approx(live, rel=1e-12)
    assert not of_inputs(tmp_path, SYNERGIES, "").values.any()
    with pytest.raises(ValueError, match="needs an input for each of its 2 synergies, got 1"):
        of_inputs(tmp_path, SYNERGIES, "/componentset/inputs|column:a")
    with pytest.raises(ValueError, match="only columns of a TableSource are supported"):
        of_inputs(tmp_path, SYNERGIES, "/forceset/BRA|activation /componentset/inputs|column:a")
    with pytest.raises(ValueError, match="has no column 'c'; its file has a, b"):
        of_inputs(tmp_path, SYNERGIES, "/componentset/inputs|column:a /componentset/inputs|column:c")


def test_inputs_take_the_place_of_what_came_before(tmp_path):
    """As in OpenSim, whose ActuatorInputController writes where others add."""
    inputs = """<ActuatorInputController name="in"><socket_actuators>/forceset/BRA</socket_actuators>
<input_controls>{inputs}</input_controls></ActuatorInputController>"""
    found = of_inputs(tmp_path, STEADY + inputs, "/componentset/inputs|column:a(/forceset/BRA)")
    law = 0.1 + 0.3 * np.minimum(found.time, 1.0)
    np.testing.assert_allclose(found.values[:, found.labels.index("BRA")], law, rtol=1e-12)
