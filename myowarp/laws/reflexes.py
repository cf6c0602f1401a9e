"""Reflexes of two legs that walk: the senses of the body excite thirteen groups of muscles a leg.

There is no rhythm: stance and swing follow from the contacts of the feet, and every group from modules that
act in some phases. With [x] = max(x, 0), load and force in units of weight and of maximum isometric forces:

    M1 stance   rectus, vasti, soleus: gain [force]          M6 swing   leg angle to its target
    M2 stance   no overstretched knee; gastrocnemii          M7 to M10  knee flexes, holds; leg stops, rests
    M3 stance   load gain [trunk's way to its target]        M5 always  ankle to its target

The leg angle is hip - knee / 2, and its target angle - gain speed - pitch, so that faster walkers place their
feet farther ahead. Angles are 180 degrees where hip and knee are straight and 90 degrees at an ankle at rest;
they fall as hip and knee flex, the ankle dorsiflexes and the leg is abducted; the trunk's pitch rises ahead
and its roll to the right. When both feet bear load the leg that is farther behind its target prepares to
swing, and hands over with the load of the other.

Sources: Geyer, Herr (2010), doi:10.1109/TNSRE.2010.2047592; Song, Geyer (2015), doi:10.1113/JP270228, in the
form that MyoSuite 2.12.2 has: angles in place of muscle lengths, no module M4, and the rectus in M1. Where we
differ from MyoSuite: its `BFSH_8_PG` takes the value of `BFSH_8_DG`; and rotators of the hip resist its
rotation, which their models of the leg do not have, or leave free.
"""

import warp as wp

real = wp.float64

GROUPS = ("HAB", "HAD", "HFL", "GLU", "HAM", "RF", "VAS", "BFSH", "GAS", "SOL", "TA", "HIR", "HER")
"""Groups of muscles in their order: hip abductors and adductors, hip flexors, glutei, hamstrings, rectus
femoris, vasti, short head of the biceps, gastrocnemii, soleus, ankle dorsiflexors, internal and external
rotators of the hip."""

Stimulation = wp.types.vector(length=len(GROUPS), dtype=wp.float64)

LEAST = wp.constant(real(0.01))  # stimulation of every muscle
CONTACT = wp.constant(real(0.1))  # load above which a foot is on the ground


@wp.struct
class Reflexes:
    """Targets [rad] and gains of both legs.

    Attributes:
        pitch: Target of the trunk's pitch.
        leg_angle: Target of the leg's angle in the world at rest.
        leg_angle_speed: What it falls by speed ahead [rad s/m].
        leg_stops: How far from its target the leg is stopped.
        knee_flexed: Knee angle up to which it flexes in early swing.
        knee_landing: Target of the knee angle in late swing.
        knee_straight: Knee angle above which it is kept from overstretching.
        ankle: Target of the ankle angle.
        hfl_pitch: M3, 1/rad.
        hfl_pitch_rate: M3, s/rad.
        hfl_leg: M6, 1/rad.
        hfl_leg_rate: M6, s/rad.
        hfl_rest: M10, 1/rad.
        glu_pitch: M3, 1/rad.
        glu_pitch_rate: M3, s/rad.
        glu_leg: M6, 1/rad.
        glu_leg_rate: M6, s/rad.
        glu_rest: M10, 1/rad.
        ham_glu: M3, of what the glutei are told there.
        ham_stop: M9, 1/rad.
        rf_force: M1.
        rf_knee_rate: M8, s/rad.
        vas_force: M1.
        vas_straight: M2, 1/rad.
        vas_rest: M10, 1/rad.
        bfsh_straight: M2, 1/rad.
        bfsh_leg_rate: M7, s/rad.
        bfsh_flex: M7, 1/rad.
        bfsh_knee_rate: M8, s/rad.
        bfsh_leg: M8, 1/rad.
        bfsh_ham: M9, of what the hamstrings are told beyond `ham_alone`.
        ham_alone: M9.
        bfsh_rest: M10, 1/rad.
        gas_force: M2.
        sol_force: M1.
        ta_ankle: M5, 1/rad.
        ta_sol: M5, what the soleus takes away.
        roll: Target of the trunk's roll to the side of the leg.
        leg_spread: Target of the leg's angle in the frontal plane at rest.
        leg_spread_speed: What it rises by speed to the other side [rad s/m].
        hab_roll: M3, 1/rad.
        hab_roll_rate: M3, s/rad.
        hab_leg: M6, 1/rad.
        had_roll: M3, 1/rad.
        had_roll_rate: M3, s/rad.
        had_leg: M6, 1/rad.
        rotation: Of the rotators, 1/rad.
        rotation_rate: Of the rotators, s/rad.
    """

    pitch: wp.float64
    leg_angle: wp.float64
    leg_angle_speed: wp.float64
    leg_stops: wp.float64
    knee_flexed: wp.float64
    knee_landing: wp.float64
    knee_straight: wp.float64
    ankle: wp.float64
    hfl_pitch: wp.float64
    hfl_pitch_rate: wp.float64
    hfl_leg: wp.float64
    hfl_leg_rate: wp.float64
    hfl_rest: wp.float64
    glu_pitch: wp.float64
    glu_pitch_rate: wp.float64
    glu_leg: wp.float64
    glu_leg_rate: wp.float64
    glu_rest: wp.float64
    ham_glu: wp.float64
    ham_stop: wp.float64
    rf_force: wp.float64
    rf_knee_rate: wp.float64
    vas_force: wp.float64
    vas_straight: wp.float64
    vas_rest: wp.float64
    bfsh_straight: wp.float64
    bfsh_leg_rate: wp.float64
    bfsh_flex: wp.float64
    bfsh_knee_rate: wp.float64
    bfsh_leg: wp.float64
    bfsh_ham: wp.float64
    ham_alone: wp.float64
    bfsh_rest: wp.float64
    gas_force: wp.float64
    sol_force: wp.float64
    ta_ankle: wp.float64
    ta_sol: wp.float64
    roll: wp.float64
    leg_spread: wp.float64
    leg_spread_speed: wp.float64
    hab_roll: wp.float64
    hab_roll_rate: wp.float64
    hab_leg: wp.float64
    had_roll: wp.float64
    had_roll_rate: wp.float64
    had_leg: wp.float64
    rotation: wp.float64
    rotation_rate: wp.float64


@wp.struct
class Senses:
    """Senses of a body; pairs are those of the right and the left leg.

    Attributes:
        pitch: Of the trunk ahead [rad].
        pitch_rate: [rad/s].
        roll: Of the trunk to the right [rad].
        roll_rate: [rad/s].
        speed_ahead: [m/s].
        speed_left: [m/s].
        load: Of the foot [weights].
        hip: Angle [rad].
        hip_rate: [rad/s].
        knee: Angle [rad].
        knee_rate: [rad/s].
        ankle: Angle [rad].
        spread: Angle of the leg in the frontal plane [rad].
        rotation: Of the hip, inwards [rad].
        rotation_rate: [rad/s].
        rf_force: Mean of the group [maximum isometric forces].
        vas_force: Likewise.
        gas_force: Likewise.
        sol_force: Likewise.
    """

    pitch: wp.float64
    pitch_rate: wp.float64
    roll: wp.float64
    roll_rate: wp.float64
    speed_ahead: wp.float64
    speed_left: wp.float64
    load: wp.vec2d
    hip: wp.vec2d
    hip_rate: wp.vec2d
    knee: wp.vec2d
    knee_rate: wp.vec2d
    ankle: wp.vec2d
    spread: wp.vec2d
    rotation: wp.vec2d
    rotation_rate: wp.vec2d
    rf_force: wp.vec2d
    vas_force: wp.vec2d
    gas_force: wp.vec2d
    sol_force: wp.vec2d


@wp.struct
class Phase:
    """Phase of a leg in its step.

    Attributes:
        planted: Its foot is on the ground.
        flexing: In swing, the knee flexes.
        holding: The knee is flexed, and held.
        stopping: The leg has come near its target, and is stopped.
        resting: It has turned back, and waits for the ground.
    """

    planted: bool
    flexing: bool
    holding: bool
    stopping: bool
    resting: bool


@wp.func
def begun() -> Phase:
    """Phase of a leg before its first: a foot that is not on the ground then has just left it."""
    phase = Phase()
    phase.planted = True
    return phase


@wp.func
def over(x: wp.float64) -> wp.float64:
    """[x] = max(x, 0)."""
    return wp.max(x, real(0.0))


@wp.func
def side_of(leg: int) -> wp.float64:
    """1 for the right leg, -1 for the left."""
    return real(1.0) - real(2.0) * real(leg)


@wp.func
def leg_target(r: Reflexes, s: Senses) -> wp.float64:
    """leg_angle - leg_angle_speed speed - pitch: of the leg's angle to the trunk."""
    return r.leg_angle - r.leg_angle_speed * s.speed_ahead - s.pitch


@wp.func
def leg_angle(s: Senses, leg: int) -> wp.float64:
    """hip - knee / 2: angle of the line from hip to ankle to the trunk."""
    return s.hip[leg] - real(0.5) * s.knee[leg]


@wp.func
def leg_rate(s: Senses, leg: int) -> wp.float64:
    """Rate of the leg's angle; below 0 as it swings ahead."""
    return s.hip_rate[leg] - real(0.5) * s.knee_rate[leg]


@wp.func
def next_phase(before: Phase, leg: int, r: Reflexes, s: Senses) -> Phase:
    """Phase that follows from what is sensed now."""
    phase = Phase()
    phase.planted = s.load[leg] > CONTACT
    if phase.planted:
        return phase
    phase.flexing = before.flexing or before.planted
    if phase.flexing:
        if s.knee[leg] < r.knee_flexed:
            phase.flexing = False
            phase.holding = True
        return phase
    target, angle = leg_target(r, s), leg_angle(s, leg)
    phase.holding = before.holding and angle >= target
    phase.stopping = before.stopping or angle < target + r.leg_stops
    phase.resting = before.resting or (phase.stopping and leg_rate(s, leg) > real(0.0))
    return phase


@wp.func
def swings_next(leg: int, r: Reflexes, s: Senses) -> bool:
    """Whether both feet bear load, and this leg is farther behind; the left one, if they are equal."""
    if wp.min(s.load[0], s.load[1]) <= CONTACT:
        return False
    return (leg_angle(s, 0) > leg_angle(s, 1)) == (leg == 0)


@wp.func
def stimulate(leg: int, phase: Phase, r: Reflexes, s: Senses):
    """Stimulation of the groups of a leg, from 0.01 to 1."""
    one, zero, load, unload = real(1.0), real(0.0), s.load[leg], s.load[1 - leg]
    stance = wp.where(phase.planted, one, zero)
    leaving = wp.where(swings_next(leg, r, s), one, zero)
    bearing = stance - leaving * unload
    swinging = one - stance + leaving * unload
    flexing = wp.where(phase.flexing, one, zero) + leaving * unload
    holding = wp.where(phase.holding, one, zero)
    stopping = wp.where(phase.stopping, one, zero)
    resting = wp.where(phase.resting, one, zero)

    target = leg_target(r, s)
    behind, rate = leg_angle(s, leg) - target, leg_rate(s, leg)
    hip = s.hip[leg] - target - real(0.5) * r.knee_landing
    knee, straight = s.knee[leg] - r.knee_landing, s.knee[leg] - r.knee_straight
    pitch = s.pitch - r.pitch
    side = side_of(leg)
    roll, roll_rate = side * s.roll - r.roll, side * s.roll_rate
    spread = s.spread[leg] - (r.leg_spread + side * (r.leg_spread_speed * s.speed_left - s.roll))

    glu_trunk = stance * load * over(r.glu_pitch * pitch + r.glu_pitch_rate * s.pitch_rate)
    ham_stop = stopping * over(r.ham_stop * (r.leg_stops - behind))
    sol_force = stance * over(r.sol_force * s.sol_force[leg])

    u = Stimulation()
    u[0] = stance * load * over(-r.hab_roll * roll - r.hab_roll_rate * roll_rate)
    u[0] += swinging * over(r.hab_leg * spread)
    u[1] = stance * load * over(r.had_roll * roll + r.had_roll_rate * roll_rate)
    u[1] += swinging * over(-r.had_leg * spread)
    u[2] = LEAST + stance * load * over(-r.hfl_pitch * pitch - r.hfl_pitch_rate * s.pitch_rate)
    u[2] += swinging * over(r.hfl_leg * behind + r.hfl_leg_rate * rate) + resting * over(r.hfl_rest * hip)
    u[3] = LEAST + glu_trunk
    u[3] += swinging * over(-r.glu_leg * behind - r.glu_leg_rate * rate) + resting * over(-r.glu_rest * hip)
    u[4] = LEAST + r.ham_glu * glu_trunk + ham_stop
    u[5] = LEAST + bearing * over(r.rf_force * s.rf_force[leg])
    u[5] += holding * over(-r.rf_knee_rate * s.knee_rate[leg])
    u[6] = LEAST + bearing * (over(r.vas_force * s.vas_force[leg]) - over(r.vas_straight * straight))
    u[6] += resting * over(-r.vas_rest * knee)
    u[7] = LEAST + bearing * over(r.bfsh_straight * straight)
    u[7] += flexing * over(r.bfsh_flex * (s.knee[leg] - r.knee_flexed) - r.bfsh_leg_rate * rate)
    u[7] += holding * over(r.bfsh_knee_rate * s.knee_rate[leg] * r.bfsh_leg * behind)
    u[7] += over(r.bfsh_ham * (ham_stop - r.ham_alone)) + resting * over(r.bfsh_rest * knee)
    u[8] = LEAST + stance * over(r.gas_force * s.gas_force[leg])
    u[9] = LEAST + sol_force
    u[10] = LEAST + over(r.ta_ankle * (s.ankle[leg] - r.ankle)) - stance * over(r.ta_sol * sol_force)
    inwards = r.rotation * s.rotation[leg] + r.rotation_rate * s.rotation_rate[leg]
    u[11] = over(-inwards)
    u[12] = over(inwards)
    for group in range(wp.static(len(GROUPS))):
        u[group] = wp.clamp(u[group], LEAST, one)
    return u


@wp.func
def felt(senses: wp.array2d[Senses], worldid: int, step: int, lag: wp.vec3i) -> Senses:
    """Senses as they arrive: those of trunk and hip, knee, and foot are a lag old, or the episode's first."""
    slots = senses.shape[1]
    s = senses[worldid, wp.max(step - lag[0], 0) % slots]
    knee = senses[worldid, wp.max(step - lag[1], 0) % slots]
    foot = senses[worldid, wp.max(step - lag[2], 0) % slots]
    s.knee = knee.knee
    s.knee_rate = knee.knee_rate
    s.rf_force = knee.rf_force
    s.vas_force = knee.vas_force
    s.load = foot.load
    s.ankle = foot.ankle
    s.gas_force = foot.gas_force
    s.sol_force = foot.sol_force
    return s


@wp.kernel(enable_backward=False)
def stimulate_legs(
    # Params:
    reflexes: wp.array[Reflexes],
    lag: wp.vec3i,
    # In:
    step_count: wp.array[int],
    senses: wp.array2d[Senses],
    # Out:
    phase: wp.array2d[Phase],
    stimulation: wp.array3d[wp.float64],
):
    """phase = next(phase, felt), stimulation = law(phase, felt); senses of step k are in slot k % slots."""
    worldid, leg = wp.tid()
    step = step_count[worldid]
    r = reflexes[worldid % reflexes.shape[0]]
    s = felt(senses, worldid, step, lag)
    before = phase[worldid, leg]
    if step == 0:
        before = begun()
    now = next_phase(before, leg, r, s)
    phase[worldid, leg] = now
    u = stimulate(leg, now, r, s)
    for group in range(stimulation.shape[2]):
        stimulation[worldid, leg, group] = u[group]
