"""While a page plays, muscles end where their bones are: every picture shows one moment (`make test-view`).

The browser draws in software while two programs keep the cores busy: what comes a picture late is far off.
"""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from chromium import NAME, Chromium

from myowarp.apps.cli.options import Said
from myowarp.apps.cli.view import View
from myowarp.definitions.setup import Setup
from myowarp.view.browser.live import Live
from myowarp.view.browser.server import close_server, open_server
from myowarp.view.drawing import style as look

pytestmark = [pytest.mark.view, pytest.mark.skipif(NAME is None, reason="needs chromium")]
OSIM = Path(__file__).parents[1] / "data" / "osim"
SHARED = Path(__file__).parents[3] / "shared" / "osim"  # beside the repository, where it is
SCENES = {
    "myoElbowPose1D6MRandom-v0": "random",
    "myoFingerPoseRandom-v0": "random",
    "myoHandReachRandom-v1": "baseline",
    "myoHandKeyTurnRandom-v1": "baseline",
    "myoHandPenTwirlRandom-v1": "baseline",
    "myoChallengeBaodingP1-v2": "random",
    "arm26.osim": "random",
    "gait10dof18musc.osim": "random",
    **({"gait2354_simbody.osim": "random"} if (SHARED / "gait2354_simbody.osim").exists() else {}),
}
PICTURES = 200  # in a row
APART, MOVED = 3.0, 30.0  # px: between muscle and bone at most, and what ends move at least
PATIENCE = 600.0  # s
SIZE = (1600, 1000)  # of which traces and panel take a part
SCALE = 0.2  # dots for each px: what is measured are places, and software draws few dots faster
WATCH = """
window.apart = []
window.watch = (ends) => {
  const fiber = Object.entries(document.querySelector('canvas').parentElement)
  let node = fiber.find(([key]) => key.startsWith('__reactFiber'))[1]
  while (!node.memoizedProps?.value?.mutable?.current?.scene) node = node.return
  const viewer = node.memoizedProps.value.mutable.current
  const inside = (object) => {
    let found
    object.traverse(part => { if (part.getMatrixAt) found ??= part })
    return found
  }
  const seen = (point, camera) => {
    point.project(camera)
    const canvas = viewer.canvas
    return [point.x * canvas.clientWidth / 2, point.y * canvas.clientHeight / 2]
  }
  const first = []
  viewer.scene.onAfterRender = (renderer, scene, camera) => {
    const tubes = inside(viewer.nodeRefFromName['/world/body/tubes'])
    if (!tubes) return
    const Matrix = tubes.matrixWorld.constructor, Vector = tubes.position.constructor
    const own = new Matrix(), points = []
    for (let i = 0; i < tubes.instancesCount; i++) {
      tubes.getMatrixAt(i, own)
      for (const z of [-0.5, 0.5])
        points.push(seen(new Vector(0, 0, z).applyMatrix4(own).applyMatrix4(tubes.matrixWorld), camera))
    }
    let worst = 0, moved = 0
    ends.forEach(([body, place], index) => {
      const batch = viewer.nodeRefFromName[`/world/body/body_${body}/mesh_0`]
      const bone = viewer.nodeRefFromName[`/world/body/body_${body}`]
      const point = new Vector(...place), copies = batch && inside(batch)
      if (copies) { copies.getMatrixAt(0, own); point.applyMatrix4(own).applyMatrix4(copies.matrixWorld) }
      else if (bone) point.applyMatrix4(bone.matrixWorld)
      else return
      const [x, y] = seen(point, camera)
      first[index] ??= [x, y]
      moved = Math.max(moved, Math.hypot(x - first[index][0], y - first[index][1]))
      worst = Math.max(worst, Math.min(...points.map(p => Math.hypot(p[0] - x, p[1] - y))))
    })
    window.apart.push([worst, moved])
  }
}
"""
"""Measures in each picture how far ends of muscles are from the places on bones to which they belong."""


def muscle_ends(model):
    """Return (body, place in it [m]) where muscles end on bodies that are drawn; of rigid ones the first."""
    roots, data = look.rigid_roots(model), mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    drawn = set(model.geom_bodyid[look.drawn_geoms(model)])
    found = []
    for tendon in look.muscle_tendons(model):
        first = model.tendon_adr[tendon]
        for at in (first, first + model.tendon_num[tendon] - 1):
            assert model.wrap_type[at] == mujoco.mjtWrap.mjWRAP_SITE
            site = model.wrap_objid[at]
            if (body := int(model.site_bodyid[site])) in drawn:
                root = int(roots[body])
                place = (data.site_xpos[site] - data.xpos[root]) @ data.xmat[root].reshape(3, 3)
                found.append((root, place.tolist()))
    return found


@pytest.fixture
def busy():
    """Both cores are in use."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    yield
    for program in programs:
        program.kill()
        program.wait()


@pytest.mark.usefixtures("busy")
@pytest.mark.parametrize("scene", SCENES)
def test_muscles_end_on_their_bones_while_it_plays(scene, tmp_path):
    task = scene
    if scene.endswith(".osim"):
        file = OSIM / scene if (OSIM / scene).exists() else SHARED / scene
        convert = [sys.executable, "-m", "myowarp", "convert", str(file), "--output", str(tmp_path)]
        subprocess.run(convert, check=True, capture_output=True)
        task = tmp_path / "model.xml"
    command = View(Said(Setup(task=task, device="cpu")), policy=SCENES[scene])
    server = open_server(0, "test")
    live = Live(server, command.open(command.title, command.policy), command.choices())
    live.ask("play", live.play)  # a model of one's own begins at rest
    ends = muscle_ends(live.session.sim.full_model)
    thread = threading.Thread(target=live.run, daemon=True)
    thread.start()
    try:
        with Chromium(SIZE, SCALE) as window:
            window.before_opening(WATCH)
            window.open(f"http://localhost:{server.get_port()}")
            window.wait_for("real time")
            time.sleep(5.0)  # until all is there
            window.run(f"watch({json.dumps(ends)})")
            until = time.monotonic() + PATIENCE
            while window.run("apart.length") < PICTURES and time.monotonic() < until:
                time.sleep(1.0)
            apart, moved = np.array(window.run("apart")).T
    finally:
        live.stop()
        thread.join(30)
        close_server(server)
    rate = len(apart) / (time.monotonic() - until + PATIENCE)
    print(f"{scene}: {len(ends)} ends, {len(apart)} pictures, {rate:.1f}/s, worst {apart.max():.2f} px apart")
    assert len(apart) >= PICTURES
    assert moved.max() > MOVED
    assert apart.max() < APART
