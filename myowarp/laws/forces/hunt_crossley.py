"""Contact of round bodies as springs that dissipate and rub: Hertz, Hunt and Crossley, and a smooth form.

Over the depth d of an overlap of radius R, with the speeds v of approach and s of slip:

    f_H = 4/3 k x sqrt(R k x)
    f   = f_H (1 + 3/2 c v)
    friction = f (min(s / v_t, 1) (u_d + 2 (u_s - u_d) / (1 + (s / v_t)^2)) + u_v s)

HuntCrossleyForce has x = d, and nothing where d or f is below 0. SmoothSphereHalfSpaceForce has everywhere

    x = sqrt(d^2 + c_f), f_H times (1 + tanh(b_d d)) / 2, f times (1 + tanh(b_v (v + 2 / (3 c)))) / 2,
    s = sqrt(s^2 + c_f)

Sources: Hunt, Crossley (1975), doi:10.1115/1.3423596; Sherman, Seth, Delp (2011),
doi:10.1016/j.piutam.2011.04.023; Serrancolí et al. (2019), doi:10.1109/TNSRE.2019.2895994; Simbody, classes
HuntCrossleyForce and SmoothSphereHalfSpaceForce. Where we differ: a contact that would pull gives no force
and lets others of its HuntCrossleyForce act; Simbody then leaves out those that come after it in a list.
"""

import warp as wp

from myowarp.laws.forces.contact_shapes import Overlap

FAR = wp.constant(wp.float64(-19.0))
"""b_d d from which 1 + tanh(b_d d) rounds to 0."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class ContactMaterial:
    """Material of two surfaces.

    Attributes:
        smooth: Whether the smooth form acts.
        stiffness: k, E^(2/3) of both in series [(N/m^2)^(2/3)].
        share: Of the first surface in the depth.
        dissipation: c [s/m].
        static_friction: u_s [1].
        dynamic_friction: u_d [1].
        viscous_friction: u_v [s/m].
        transition_velocity: v_t [m/s].
        constant_contact_force: c_f, under OpenSim's name [m^2] and [m^2/s^2].
        hertz_smoothing: b_d [1/m].
        hunt_crossley_smoothing: b_v [s/m].
    """

    smooth: int
    stiffness: wp.float64
    share: wp.float64
    dissipation: wp.float64
    static_friction: wp.float64
    dynamic_friction: wp.float64
    viscous_friction: wp.float64
    transition_velocity: wp.float64
    constant_contact_force: wp.float64
    hertz_smoothing: wp.float64
    hunt_crossley_smoothing: wp.float64


@wp.struct
class Touch:
    """Force of a contact.

    Attributes:
        force: On the second body [N].
        damping: Of approach, df/dv [N s/m].
        drag: Friction over slip [N s/m].
    """

    force: wp.vec3d
    damping: wp.float64
    drag: wp.float64


@wp.func
def rising(x: wp.float64) -> wp.float64:
    """(1 + tanh(x)) / 2."""
    return wp.float64(0.5) + wp.float64(0.5) * wp.tanh(x)


@wp.func
def drag_of(material: ContactMaterial, force: wp.float64, slip: wp.float64) -> wp.float64:
    """Friction / s [N s/m], of the force across the surfaces."""
    share = slip / material.transition_velocity
    more = material.static_friction - material.dynamic_friction
    rubbing = material.dynamic_friction + wp.float64(2.0) * more / (wp.float64(1.0) + share * share)
    return force * (rubbing / wp.max(slip, material.transition_velocity) + material.viscous_friction)


@wp.func
def touch(material: ContactMaterial, overlap: Overlap, velocity: wp.vec3d) -> Touch:
    """Return what a contact does; of the velocity of the first body past the second."""
    found = Touch()
    one, zero, c = wp.float64(1.0), wp.float64(0.0), material.dissipation
    approach = wp.dot(velocity, overlap.normal)
    sliding = velocity - approach * overlap.normal
    x, slip, switch = wp.float64(overlap.depth), wp.float64(wp.length(sliding)), wp.float64(1.0)
    if material.smooth != 0:
        if material.hertz_smoothing * x < FAR:
            return found
        x = wp.sqrt(x * x + material.constant_contact_force)
        slip = wp.sqrt(slip * slip + material.constant_contact_force)
        switch = rising(material.hertz_smoothing * overlap.depth)
        if c > zero:
            begin = wp.float64(2.0) / (wp.float64(3.0) * c)
            switch *= rising(material.hunt_crossley_smoothing * (approach + begin))
    elif x <= zero:
        return found
    k = material.stiffness
    hertz = wp.float64(4.0) / wp.float64(3.0) * k * x * wp.sqrt(overlap.radius * k * x) * switch
    force = hertz * (one + wp.float64(1.5) * c * approach)
    if material.smooth == 0 and force <= zero:
        return found
    found.drag = drag_of(material, force, slip)
    found.damping = wp.float64(1.5) * c * hertz
    found.force = force * overlap.normal + found.drag * sliding
    return found
