"""The contact families: what their formulas need, the formulas in float64, states to be written.

Every family gives
- `terms`, `objects`: names of the reward terms and of the object bodies,
- `state(env)`: the quantities the formulas need, the randomised ones included,
- `expected(get, env)`: observation, reward terms and flags from recorded arrays,
- `forced(wrapped, rng)`: one written state after the other, together they hit every branch,
- `place(env, rng)`: writes a random hand with the objects close to it.
"""

import itertools

import mujoco
import numpy as np
from contact_states import (
    NUM_HAND,
    direction,
    hand_pose,
    palm,
    place_at_palm,
    random_quat,
    rotation,
    site,
    start_forced,
)
from recording import euler

MUSCLE = ("length", "velocity", "force")  # of MjData.actuator_*, which reorient observes


def norm(vectors):
    return np.linalg.norm(vectors, axis=-1)


def act_reg(get, env):
    return -norm(get["act"]) / env.model.na


class KeyTurn:
    name = "key"
    terms = ("key_turn", "IFtip_approach", "THtip_approach", "act_reg", "bonus", "penalty")
    objects = ("key",)
    gap, far = 0.03, 0.1  # [m]
    gaps = (0.045, 0.0495, 0.0505, 0.07, 0.0995, 0.1005, 0.13)  # around far / 2 and far
    angles = (-1.0, 0.0, 1.57, 1.5718, 2.0, 3.139, 3.1408, 3.1426, 4.0, 6.282, 6.2842)

    def state(self, env):
        tips = {"iftip": site(env, "IFtip"), "thtip": site(env, "THtip")}
        angle = {"key_angle": env.data.qpos[-1], "key_velocity": env.data.qvel[-1]}
        place = {"keyhead": site(env, "keyhead"), "key_pos": env.model.body("key").pos.copy()}
        return tips | angle | place

    def expected(self, get, env):
        index, thumb = (get["keyhead"] - get[tip] for tip in ("iftip", "thtip"))
        a, b = (np.abs(norm(v) - self.gap) for v in (index, thumb))
        angle = get["key_angle"]
        out = {"reward_key_turn": angle, "sparse": angle, "reward_act_reg": act_reg(get, env)}
        out |= {"reward_IFtip_approach": -a, "reward_THtip_approach": -b}
        out["reward_bonus"] = 1.0 * (angle > np.pi / 2) + 1.0 * (angle > np.pi)
        out["reward_penalty"] = -1.0 * (a > self.far / 2) - 1.0 * (b > self.far / 2)
        out["solved"] = angle > env.goal_th
        out["done"] = (a > self.far) | (b > self.far)
        qvel = get["qvel"] * env.dt
        columns = (get["qpos"][:, :-1], qvel[:, :-1], get["qpos"][:, -1:], qvel[:, -1:])
        return out | {"obs": np.hstack([*columns, index, thumb, get["act"]])}

    def gaps_of(self, env, hand):
        env.data.qpos[:NUM_HAND] = hand
        mujoco.mj_forward(env.model, env.data)
        head = site(env, "keyhead")
        return [abs(norm(head - site(env, tip)) - self.gap) for tip in ("IFtip", "THtip")]

    def forced(self, wrapped, rng):
        """Both gaps in all bands, each gap close to its thresholds, the key angle close to its."""
        bands = itertools.product(itertools.product(range(3), range(3)), (0.5, 2.0, 7.0))
        cases = [(self.band, case) for case in bands]
        cases += [(self.at, case) for case in itertools.product(itertools.product((0, 1), self.gaps), (0.3,))]
        cases += [(self.band, ((0, 0), angle)) for angle in self.angles]
        for find, (wanted, angle) in cases:
            env = start_forced(wrapped, rng, 0.0)
            env.data.qpos[:] = np.append(find(env, rng, wanted), angle)
            yield {}

    def band(self, env, rng, bands):
        """Random hand with both gaps in the given bands (0 near, 1 penalty, 2 done)."""
        while True:
            hand = hand_pose(env, rng, rng.uniform(0.2, 1.0), rng.uniform(size=3))
            gaps = np.array(self.gaps_of(env, hand)) / self.far
            if tuple(np.digitize(gaps, (0.48, 1.02))) == bands:
                return hand

    def at(self, env, rng, wanted):
        """Hand with the gap of one tip at a value: bisection between two random hands."""
        tip, gap = wanted
        near, far = self.band(env, rng, (0, 0)), self.band(env, rng, (2, 2))
        for _ in range(50):
            middle = (near + far) / 2
            over = self.gaps_of(env, middle)[tip] > gap
            near, far = (near, middle) if over else (middle, far)
        return near

    def place(self, env, rng):
        """Random hand next to the key."""
        env.data.qpos[:NUM_HAND] = hand_pose(env, rng, 1.0, 0.3)
        env.data.qpos[-1] = rng.uniform(-np.pi, np.pi)


class ObjHold:
    name = "hold"
    terms = ("goal_dist", "bonus", "act_reg", "penalty")
    objects = ("object",)
    near, far = 0.01, 0.3  # [m]
    distances = (0.0, 0.005, 0.0099, 0.0101, 0.015, 0.0199, 0.0201, 0.05, 0.15, 0.299, 0.301, 0.5)

    def state(self, env):
        places = {"object_pos": site(env, "object"), "goal_pos": site(env, "goal")}
        geom = env.model.geom("object")
        return places | {"object_quat": env.data.qpos[-4:].copy(), "object_size": geom.size.copy()}

    def expected(self, get, env):
        error = get["goal_pos"] - get["object_pos"]
        x = norm(error)
        out = {"reward_goal_dist": -x, "sparse": -x, "reward_act_reg": act_reg(get, env)}
        out["reward_bonus"] = 1.0 * (x < 2 * self.near) + 1.0 * (x < self.near)
        out["reward_penalty"] = -1.0 * (x > self.far)
        out |= {"solved": x < self.near, "done": x > self.far}
        columns = (get["qpos"][:, :-7], get["qvel"][:, :-6] * env.dt)
        return out | {"obs": np.hstack([*columns, get["object_pos"], error, get["act"]])}

    def forced(self, wrapped, rng):
        for distance in np.repeat(self.distances, 5):
            env = start_forced(wrapped, rng, rng.uniform(0.0, 0.6))
            position = site(env, "goal") + distance * direction(rng)
            env.data.qpos[-7:] = np.append(position, random_quat(rng))
            yield {"distance": distance}

    def place(self, env, rng):
        env.data.qpos[-7:] = np.append(place_at_palm(env, rng), random_quat(rng))


class PenTwirl:
    name = "pen"
    terms = ("pos_align", "rot_align", "act_reg", "drop", "bonus")
    objects = ("Object", "target")
    far, length = 0.075, 0.13  # [m]
    distances = (0.0, 0.03, 0.0745, 0.0755, 0.15)
    cosines = (-0.9, 0.5, 0.895, 0.905, 0.945, 0.955, 1.0)

    def state(self, env):
        sites = ("object_top", "object_bottom", "target_top", "target_bottom", "eps_ball")
        pen, target = env.data.body("Object"), env.model.body("target")
        row = {name: site(env, name) for name in sites} | {"object_pos": pen.xpos.copy()}
        return row | {"object_quat": pen.xquat.copy(), "target_quat": target.quat.copy()}

    def expected(self, get, env):
        pen = (get["object_top"] - get["object_bottom"]) / self.length
        wanted = (get["target_top"] - get["target_bottom"]) / self.length
        offset = get["object_pos"] - get["eps_ball"]
        p, c = norm(offset), np.sum(pen * wanted, axis=1) / norm(pen) / norm(wanted)
        out = {"reward_pos_align": -p, "reward_rot_align": c, "reward_act_reg": act_reg(get, env)}
        out |= {"reward_drop": -1.0 * (p > self.far), "sparse": c - p, "done": p > self.far}
        out["reward_bonus"] = (1.0 * (c > 0.9) + 5.0 * (c > 0.95)) * (p < self.far)
        out["solved"] = (c > 0.95) & (p <= self.far)
        columns = (get["object_pos"], get["qvel"][:, -6:] * env.dt, pen, wanted, offset)
        # The pen's axis from its joints, the target's from its quaternion.
        a, b = get["qpos"][:, -3:-1].T
        local = np.stack([np.sin(b), -np.sin(a) * np.cos(b), np.cos(a) * np.cos(b)], axis=1)
        half = self.length / 2 * local @ rotation(env.model.body("Object").quat).T
        out["object_top"] = get["object_pos"] + half
        half = self.length / 2 * np.array([rotation(q)[:, 2] for q in get["target_quat"]])
        out["target_top"] = env.model.body("target").pos + half
        hand, pose_error = get["qpos"][:, :-6], pen - wanted
        return out | {"obs": np.hstack([hand, *columns, pose_error, get["act"]])}

    def forced(self, wrapped, rng):
        cases = itertools.product(self.distances, self.cosines, range(2))
        for distance, cosine, _ in cases:
            env = start_forced(wrapped, rng, rng.uniform(0.0, 0.6))
            axis = rotation(env.data.body("target").xquat)[:, 2]
            side = np.cross(axis, direction(rng))
            side /= np.linalg.norm(side)
            axis = cosine * axis + np.sqrt(1 - cosine**2) * side
            self.write(env, site(env, "eps_ball") + distance * direction(rng), axis, rng)
            yield {"distance": distance, "cosine": cosine}

    def write(self, env, position, axis, rng):
        """Joint values of the pen for a position and a direction of its axis."""
        body = env.model.body("Object")
        frame = rotation(body.quat).T
        x, y, z = frame @ axis
        env.data.qpos[-6:-3] = frame @ (position - body.pos)
        env.data.qpos[-3:] = np.arctan2(-y, z), np.arcsin(x), rng.uniform(-np.pi, np.pi)

    def place(self, env, rng):
        self.write(env, place_at_palm(env, rng), direction(rng), rng)


class Die:
    name = "die"
    terms = ("pos_dist", "rot_dist", "bonus", "act_reg", "penalty")
    objects = ("Object", "target")
    aligned, far = 0.262, 0.2  # rad, m
    beside = (-0.1, 0.0, 0.0)  # m, from where the die should be to where the wanted one is shown
    distances = (0.0, 0.0249, 0.0251, 0.04, 0.0499, 0.0501, 0.1, 0.199, 0.201, 0.3)
    angles = (0.0, 0.1, 0.261, 0.263, 1.0, 3.0)

    def state(self, env):
        die, target = env.data.body("Object"), env.model.body("target")
        row = {"object_pos": die.xpos.copy(), "object_quat": die.xquat.copy()}
        return row | {"target_pos": target.pos.copy(), "target_quat": target.quat.copy()}

    def expected(self, get, env):
        place = get["target_pos"] - get["object_pos"] - self.beside
        die, wanted = euler(get["object_quat"]), euler(get["target_quat"])
        turn = wanted - die
        p, r = norm(place), norm(turn)
        out = {"reward_pos_dist": -p, "reward_rot_dist": -r, "reward_act_reg": act_reg(get, env)}
        out["reward_bonus"] = 1.0 * (p < 2 * env.pos_th) + 1.0 * (p < env.pos_th)
        out |= {"reward_penalty": -1.0 * (p > self.far), "sparse": -r - 10.0 * p, "done": p > self.far}
        out["solved"] = (p < env.pos_th) & (r < self.aligned) & (p <= self.far)
        columns = (
            get["qpos"][:, :-7],
            get["qvel"][:, :-6] * env._ctrl_dt,
            get["object_pos"],
            get["target_pos"],
        )
        return out | {"obs": np.hstack([*columns, place, die, wanted, turn, get["act"]])}

    def forced(self, wrapped, rng):
        """All distances and all angles, around their thresholds."""
        for distance, angle in itertools.product(self.distances, self.angles):
            env = start_forced(wrapped, rng, rng.uniform(0.0, 0.6))
            target = env.model.body("target")
            place = target.pos - self.beside + distance * direction(rng)
            wanted = euler(target.quat[None])[0]
            self.write(env, place, wanted + angle * direction(rng))
            yield {"distance": distance, "angle": angle}

    def write(self, env, position, angles):
        """Put the die at a position, turned by angles about its three hinges."""
        env.data.qpos[-6:-3] = position - env.model.body("Object").pos
        env.data.qpos[-3:] = angles

    def place(self, env, rng):
        """Further from the palm than smaller objects, so that die and hand overlap as little as they do."""
        apart = rng.uniform(0.04, 0.07) * direction(rng)
        self.write(env, place_at_palm(env, rng) + apart, rng.uniform(-np.pi, np.pi, 3))


class Relocate:
    name = "relocate"
    terms = ("pos_dist", "rot_dist", "act_reg")
    objects = ("Object", "target")
    distances = (0.0, 0.05, 0.0999, 0.1001, 0.2, 0.5)  # m, from the bin
    reaches = (0.05, 0.3, 0.4999, 0.5001, 0.8)  # m, from the palm
    angles = (0.0, 1.0, 3.0)

    def state(self, env):
        held, target = env.data.body("Object"), env.model.body("target")
        row = {"object_pos": held.xpos.copy(), "object_quat": held.xquat.copy(), "palm_pos": palm(env)}
        row["object_origin"] = env.model.body("Object").pos.copy()
        return row | {"target_pos": target.pos.copy(), "target_quat": target.quat.copy()}

    def expected(self, get, env):
        place = get["target_pos"] - get["object_pos"]
        held, wanted = euler(get["object_quat"]), euler(get["target_quat"])
        p, r, reach = norm(place), norm(wanted - held), norm(get["palm_pos"] - get["object_pos"])
        out = {"reward_pos_dist": -p, "reward_rot_dist": -r, "reward_act_reg": act_reg(get, env)}
        out |= {"sparse": -r - 10.0 * p, "done": reach > env.drop_th}
        out["solved"] = (p < env.pos_th) & (r < env.rot_th) & (reach <= env.drop_th)
        columns = (
            get["qpos"][:, :-6],
            get["qvel"][:, :-6] * env._ctrl_dt,
            get["object_pos"],
            get["target_pos"],
        )
        return out | {"obs": np.hstack([*columns, place, held, wanted, wanted - held, get["act"]])}

    def forced(self, wrapped, rng):
        """All distances from the bin and the palm, around their thresholds."""
        for distance, reach, angle in itertools.product(self.distances, self.reaches, self.angles):
            env = start_forced(wrapped, rng, rng.uniform(0.0, 0.6))
            place = palm(env) + reach * direction(rng)
            self.write(env, place, angle * direction(rng))
            env.model.body_pos[env.goal_bid] = place + distance * direction(rng)
            env.data.mocap_pos[env.goal_mocap_id] = env.model.body_pos[env.goal_bid]
            yield {"distance": distance, "reach": reach}

    def write(self, env, position, angles):
        """Put the object at a position, turned by angles about its three hinges."""
        env.data.qpos[-6:-3] = position - env.model.body("Object").pos
        env.data.qpos[-3:] = angles

    def place(self, env, rng):
        """Some way from the palm, as the die."""
        apart = rng.uniform(0.03, 0.06) * direction(rng)
        self.write(env, place_at_palm(env, rng) + apart, rng.uniform(-np.pi, np.pi, 3))


class Reorient(PenTwirl):
    name = "reorient"
    objects = ("Object", "target")
    middle = (-0.248, -0.532, 1.445)  # m, of the place on the palm

    def state(self, env):
        held, target = env.data.body("Object"), env.model.body("target")
        row = {"object_pos": held.xpos.copy(), "object_quat": held.xquat.copy()}
        row |= {f"muscle_{k}": getattr(env.data, f"actuator_{k}").copy() for k in MUSCLE}
        return row | {"target_quat": target.quat.copy()}

    def expected(self, get, env):
        held, wanted = (
            np.array([rotation(q)[:, 2] for q in get[f"{name}_quat"]]) for name in ("object", "target")
        )
        offset = get["object_pos"] - self.middle
        p, c = norm(offset), np.sum(held * wanted, axis=1)
        out = {"reward_pos_align": -p, "reward_rot_align": c, "reward_act_reg": act_reg(get, env)}
        out |= {"reward_drop": -1.0 * (p > self.far), "sparse": c - p, "done": p > self.far}
        out["reward_bonus"] = (1.0 * (c > 0.9) + 5.0 * (c > 0.95)) * (p < self.far)
        out["solved"] = (c > 0.95) & (p <= self.far)
        columns = (get["object_pos"], get["qvel"][:, -6:] * env._ctrl_dt, held, wanted, offset)
        muscles = (get[f"muscle_{k}"] for k in MUSCLE)
        return out | {"obs": np.hstack([get["qpos"][:, :-6], *columns, held - wanted, *muscles, get["act"]])}

    def forced(self, wrapped, rng):
        for distance, cosine, _ in itertools.product(self.distances, self.cosines, range(2)):
            env = start_forced(wrapped, rng, rng.uniform(0.0, 0.6))
            axis = rotation(env.model.body("target").quat)[:, 2]
            side = np.cross(axis, direction(rng))
            side /= np.linalg.norm(side)
            axis = cosine * axis + np.sqrt(1 - cosine**2) * side
            self.write(env, np.array(self.middle) + distance * direction(rng), axis, rng)
            yield {"distance": distance, "cosine": cosine}


class Baoding:
    name = "baoding"
    terms = ("pos_dist_1", "pos_dist_2", "act_reg")
    objects = ("ball1", "ball2")
    near, height = 0.015, 1.25  # [m]
    center = (-0.0125, -0.07, -0.02)  # of the targets' ellipse, in the frame of the trapezium
    signs = (0, -1, 1)  # of the tasks hold, clockwise, counter-clockwise
    distances = (0.0, 0.0149, 0.0151, 0.05)
    counts = (0, 1, 37, 199)
    heights = (1.2499, 1.2501, 1.0, 1.4)

    def state(self, env):
        """Targets of `phase` control steps after the reset; `counter` steps are done."""
        bone, balls = env.data.body("trapezium"), [env.model.geom(name) for name in self.objects]
        row = {f"target{i}_pos": site(env, f"target{i}_site") for i in (1, 2)}
        row |= {f"ball{i}_pos": site(env, f"ball{i}_site") for i in (1, 2)}
        row |= {"trapezium_pos": bone.xpos.copy(), "trapezium_quat": bone.xquat.copy()}
        row |= {"counter": env.counter, "phase": max(env.counter - 1, 0)}
        row |= {"task": env.which_task.value, "sign": self.signs[env.which_task.value]}
        row |= {"period": env.recorded_period, "radii": np.array([env.x_radius, env.y_radius])}
        row["start_angles"] = np.array([env.ball_1_starting_angle, env.ball_2_starting_angle])
        row["ball_mass"] = np.array([env.model.body(name).mass[0] for name in self.objects])
        row["ball_radius"] = np.array([ball.size[0] for ball in balls])
        return row | {"ball_friction": np.stack([ball.friction for ball in balls])}

    def targets(self, get, env):
        turn = get["sign"] * 2 * np.pi * (get["phase"] * env.dt / get["period"])
        frames = np.array([rotation(q) for q in get["trapezium_quat"]])
        for i in range(2):
            angle = get["start_angles"][:, i] + turn
            local = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
            local[:, :2] *= get["radii"]
            world = np.einsum("nij,nj->ni", frames, local + self.center)
            yield f"target{i + 1}_pos", get["trapezium_pos"] + world

    def expected(self, get, env):
        out = dict(self.targets(get, env))
        balls, goals = ([get[f"{n}{i}_pos"] for i in (1, 2)] for n in ("ball", "target"))
        errors = [goal - ball for goal, ball in zip(goals, balls, strict=True)]
        first, second = map(norm, errors)
        fall = (balls[0][:, 2] < self.height) | (balls[1][:, 2] < self.height)
        out |= {"reward_pos_dist_1": -first, "reward_pos_dist_2": -second, "done": fall}
        out |= {"reward_act_reg": act_reg(get, env), "sparse": -(first + second)}
        out["solved"] = (first < self.near) & (second < self.near) & ~fall
        velocity = get["qvel"] * env.dt
        moving = (balls[0], velocity[:, -12:-9], balls[1], velocity[:, -6:-3])
        columns = (get["qpos"][:, :-14], *moving, *goals, *errors, get["act"])
        return out | {"obs": np.hstack(columns)}

    def forced(self, wrapped, rng):
        """Balls at distances from their targets at several counts, then balls at heights."""
        cases = [(pair, None) for pair in itertools.product(self.distances, self.distances)]
        cases = [(*case, count) for case in cases for count in self.counts]
        cases += [((0.0, 0.0), pair, 5) for pair in itertools.product(self.heights, self.heights)]
        for distances, heights, count in cases:
            env = start_forced(wrapped, rng, rng.uniform(0.0, 0.5))
            env.counter = count
            env._update_target_sites()
            env.counter += 1  # as after the step that these targets belong to
            mujoco.mj_kinematics(env.model, env.data)
            for i, distance in enumerate(distances):
                position = site(env, f"target{i + 1}_site") + distance * direction(rng)
                if heights is not None:
                    position[2] = heights[i]
                env.data.qpos[23 + 7 * i : 30 + 7 * i] = np.append(position, random_quat(rng))
            yield {"distance": np.array(distances)}

    def place(self, env, rng):
        palm = place_at_palm(env, rng)
        apart = 0.024 * direction(rng)
        both = [np.append(palm + side * apart, random_quat(rng)) for side in (1, -1)]
        env.data.qpos[-14:] = np.concatenate(both)
