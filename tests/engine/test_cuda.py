"""CUDA: all device code compiles for it, which needs no GPU, and on a machine with one it runs alike."""

import importlib
import multiprocessing
import pkgutil
import re
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
import warp as wp

import myowarp
from benchmarks.gpu_cases import Case, Environment, random_actions, trajectory
from myowarp.definitions.task import TASKS
from myowarp.engine import repeat
from myowarp.engine.compile import recorded
from myowarp.engine.stages.contact_solve import solver_kernel
from myowarp.engine.stages.primitive_contacts import CLOSED_FORMS, touch_kernel
from myowarp.engine.verify import is_same_step
from myowarp.sim.build import compile_scene
from myowarp.sim.simulation import Simulation

ARCHITECTURE = 90  # compute capability 9.0, without a meaning of its own
THREADS = 2  # cores that CI has
ELBOW, HAND = "myoElbowPose1D6MRandom-v0", "myoHandPoseRandom-v0"
AFTER_STEPS = 1e-3  # rad after five control steps: float32 sums in another order, grown by the dynamics
EXPECTED = 0.01  # rad at least that the hand moves meanwhile

needs_compiler = pytest.mark.skipif(
    ARCHITECTURE not in wp.get_cuda_supported_archs(), reason="this build of Warp has no CUDA compiler"
)
needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")


def kernel_modules():
    """Return the Warp modules of all of the package's kernels by name, but for the CPU's own solver."""
    found = {}
    for entry in pkgutil.walk_packages(myowarp.__path__, "myowarp."):
        if ".opensim." in entry.name or ".view" in entry.name:
            continue  # host code behind extras
        module = importlib.import_module(entry.name)
        kernels = [value for value in vars(module).values() if isinstance(value, wp.Kernel)]
        found |= {kernel.module.name: kernel.module for kernel in kernels}
    modules = [touch_kernel(kind).module for kind in CLOSED_FORMS]
    for key in {TASKS[key].family: key for key in TASKS}.values():
        with wp.ScopedDevice("cpu"):
            program = TASKS[key].program(TASKS[key], compile_scene(TASKS[key], 1, device="cpu"))
        modules += [kernel.module for kernel in program._kernels]
    return found | {module.name: module for module in modules}


def compile_for_cuda(module, folder):
    wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=folder, use_ptx=True)


def compile_share(share, folder):
    """Compile every second module; returns how many."""
    mine = list(kernel_modules().items())[share::THREADS]
    for name, module in mine:
        compile_for_cuda(module, folder / name)
        assert list((folder / name).glob("*.ptx")), name
    return len(mine)


@needs_compiler
def test_every_kernel_compiles(tmp_path):
    """In processes of their own: other tests import modules anew, whose kernels are then elsewhere."""
    with ProcessPoolExecutor(THREADS, multiprocessing.get_context("spawn")) as pool:
        numbers = list(pool.map(compile_share, range(THREADS), [tmp_path] * THREADS))
    assert sum(numbers) >= 25
    assert len(list(tmp_path.glob("*/*.ptx"))) >= sum(numbers)


@needs_compiler
def test_native_solver_does_not_compile(tmp_path, capfd):
    """It is C++ for one thread of a CPU, so that the stage has to refuse every other device."""
    with pytest.raises(Exception, match="CUDA kernel build failed"):
        compile_for_cuda(solver_kernel(8).module, tmp_path)
    assert "error" in "".join(capfd.readouterr())


def test_launches_are_recorded_with_their_blocks():
    """CUDA code is made for a number of threads: that of the launch, Warp's 256 where it names none."""
    countdown = wp.zeros(1, dtype=int, device="cpu")
    with recorded() as found:
        wp.launch(repeat.count_down, dim=1, outputs=[countdown])
        wp.launch_tiled(repeat.count_down, dim=1, outputs=[countdown], block_dim=32)
    module = repeat.count_down.module
    assert found == [(module, 256), (module, 32)]
    assert countdown.numpy()[0] == 0


@pytest.mark.skipif(wp.is_cuda_available(), reason="for machines without a GPU")
def test_driver_that_is_too_old(monkeypatch):
    monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (12, 2))
    monkeypatch.setattr(wp, "get_cuda_toolkit_version", lambda: (13, 4))
    sentence = (
        "device 'cuda:0' is not available; available: cpu "
        "(Warp needs an NVIDIA driver of CUDA 13.0 or newer, got 12.2; update the driver)"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        Simulation(TASKS[ELBOW], 1, device="cuda:0")


def test_same_step_to_rounding():
    """Rounding passes where sums have no order; a kernel left out does not; on the CPU no bit may differ."""
    rng = np.random.default_rng(0)
    start, stock = rng.normal(size=(2, 9, 5))
    rounded, other = stock * (1.0 + 1e-7), stock + 1e-2
    assert is_same_step(start, stock.copy(), stock, exact=True)
    assert not is_same_step(start, rounded, stock, exact=True)
    assert is_same_step(start, rounded, stock, exact=False)
    assert not is_same_step(start, other, stock, exact=False)


@needs_gpu
def test_worlds_are_those_of_the_cpu():
    runs = []
    for device in ("cpu", "cuda:0"):
        sim = Simulation(TASKS[HAND], 8, device=device, progress=False)
        runs.append(trajectory(sim, random_actions(sim, 5))["qpos"])
    assert np.ptp(runs[0], axis=0).max() > EXPECTED
    np.testing.assert_allclose(runs[1], runs[0], rtol=0, atol=AFTER_STEPS)


@needs_gpu
def test_runs_with_launches_in_order_agree():
    """To rounding: rows of constraints get their places as threads come."""
    sim = Simulation(TASKS[HAND], 64, device="cuda:0", deterministic=True, progress=False)
    actions = random_actions(sim, 5)
    first, second = trajectory(sim, actions), trajectory(sim, actions)
    np.testing.assert_allclose(first["qpos"], second["qpos"], rtol=0, atol=AFTER_STEPS)


@needs_gpu
def test_steps_allocate_and_read_back_nothing():
    pytest.importorskip("torch")
    env = Environment(Case("rates", HAND, "parity", 64), wp.get_device("cuda:0"))
    env.step()
    used = env.footprint(steps=5)
    assert (used["pool_growth_bytes"], used["memory_growth_bytes"], used["host_reads"]) == (0, 0, 0)


@needs_gpu
def test_torch_sees_the_arrays_themselves():
    pytest.importorskip("torch")
    env = Environment(Case("rates", ELBOW, "parity", 4), wp.get_device("cuda:0"))
    obs = env.env.step(env.draw())[0]
    assert obs.data_ptr() == env.sim.transition.obs.ptr
