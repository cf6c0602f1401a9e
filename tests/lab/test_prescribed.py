"""A model's own controllers as a policy, by the closed forms of their functions; XML as in OpenSim 4.6."""

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


def test_a_model_without_controllers_is_one_sentence(tmp_path):
    path = tmp_path / "bare.osim"
    path.write_text(ARM)
    with pytest.raises(ValueError, match="needs a PrescribedController that is on; the model has none"):
        prescribed(path, SPEC)
