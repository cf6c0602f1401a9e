"""A contact between two bodies: shapes that overlap, and a force at a point between them.

The point divides the overlap as the surfaces give way: it is `share` of the depth from the first one's.
Source: Simbody, classes HuntCrossleyForce and SmoothSphereHalfSpaceForce.
"""

import warp as wp

from myowarp.laws.forces.bushing import BodyMotion
from myowarp.laws.forces.contact_shapes import (
    ELLIPSOID,
    HALF_SPACE,
    Overlap,
    ellipsoid_in_half_space,
    ellipsoids,
    sphere_in_half_space,
    spheres,
)
from myowarp.laws.forces.hunt_crossley import ContactMaterial, Touch, touch

wp.set_module_options({"enable_backward": False})


@wp.struct
class ContactSurface:
    """A half space, a sphere or an ellipsoid on a body.

    Attributes:
        body: Its number, -1 for ground.
        kind: `HALF_SPACE`, `SPHERE` or `ELLIPSOID`.
        rotation: Axes in the body; a half space is where its x is above 0.
        origin: Centre there, or a point of the plane [m].
        size: Half axes, of a sphere three radii [m].
    """

    body: int
    kind: int
    rotation: wp.mat33d
    origin: wp.vec3d
    size: wp.vec3d


@wp.struct
class Contact:
    """Two surfaces that may touch; a half space is the first."""

    first: ContactSurface
    second: ContactSurface
    material: ContactMaterial


@wp.struct
class Wrench:
    """Force of a contact on its second body, and its place; the first body gets the opposite.

    Attributes:
        touch: The force [N] and its slopes.
        normal: Out of the first body.
        location: [m], in ground.
    """

    touch: Touch
    normal: wp.vec3d
    location: wp.vec3d


@wp.func
def overlap_of(contact: Contact, first: BodyMotion, second: BodyMotion) -> Overlap:
    """Return the overlap of two surfaces; of where their bodies are."""
    one, two = contact.first, contact.second
    first_axes, first_origin = first.rotation * one.rotation, first.origin + first.rotation * one.origin
    second_axes, second_origin = second.rotation * two.rotation, second.origin + second.rotation * two.origin
    if one.kind == HALF_SPACE:
        if two.kind == ELLIPSOID:
            return ellipsoid_in_half_space(first_axes, first_origin, second_axes, second_origin, two.size)
        return sphere_in_half_space(first_axes, first_origin, second_origin, two.size[0])
    if one.kind == ELLIPSOID or two.kind == ELLIPSOID:
        return ellipsoids(first_axes, first_origin, one.size, second_axes, second_origin, two.size)
    return spheres(first_origin, one.size[0], second_origin, two.size[0])


@wp.func
def contact_wrench(contact: Contact, first: BodyMotion, second: BodyMotion) -> Wrench:
    """Return what a contact does; of where its bodies are and how they move."""
    overlap = overlap_of(contact, first, second)
    found = Wrench()
    found.normal = overlap.normal
    within = wp.float64(0.5) - contact.material.share
    found.location = overlap.location + overlap.depth * within * found.normal
    velocity = first.shift - second.shift + wp.cross(first.turn - second.turn, found.location)
    found.touch = touch(contact.material, overlap, velocity)
    return found
