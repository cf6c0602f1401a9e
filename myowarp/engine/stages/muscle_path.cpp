// Paths of tendons of the worlds of a block (muscle_path.py explains what is computed, lanes.cpp what V is).
//
// A segment bends round a geom in the plane through its ends and the geom's centre, on a cylinder the plane
// across its axis; all is relative to the centre, in world axes. The path runs straight to the circle of
// radius r, along it, and straight on. With an end e, the normal n of the plane and the sense of turn s = 1
// or -1 it leaves the first end, and reaches the last, along
//
//     u = (s r n x e - t e) / e^2,    u = (s r n x e + t e) / e^2,    t = sqrt(e^2 - r^2)
//
// where t is the length of the straight piece, and the arc is the angle between both u. Without a side site
// it bends only where the straight segment would cut the circle, the short way round. A side site says on
// which side the path passes: MuJoCo 4 compares the winding angle of the path over the side site with that
// of the straight segment. They differ exactly if the triangle of ends and side site holds the centre, which
// is three signs of cross products, and the path then winds as the side site does. So only a path that bends
// costs an arc tangent. A side site inside the geom makes the path pass through it and touch it where it is
// shortest.
namespace lanes {

enum { STRAIGHT, SPHERE, CYLINDER };  // muscle_path.py has the same
constexpr int NEWTON_STEPS = 8, HALVINGS = 24;
constexpr float STILL = 3e-4f;  // rad, after which a step of Newton's leaves what float32 cannot see

template <class V> struct Bend { V length; Vec3<V> onto, off; };  // directions at the near and the far end

// v / |v|, (1, 0, 0) for a zero vector as MuJoCo does.
template <class V> INLINE Vec3<V> unit(Vec3<V> v, V length) {
    const Vec3<V> first = {splat<V>(1.0f), splat<V>(0.0f), splat<V>(0.0f)};
    return select(length < TINY, first, (1.0f / length) * v);
}

// The normal of the plane through two points and the centre; of any one if these are in line.
template <class V> INLINE Vec3<V> sphere_normal(Vec3<V> near, Vec3<V> far) {
    Vec3<V> normal = cross(near, cross(cross(near, far), near));  // square to `near` in spite of rounding
    V length = root(dot(normal, normal));
    const auto in_line = length == 0.0f;
    if (any(in_line)) {
        const auto least = absolute(near.x) < absolute(near.y);
        const V one = splat<V>(1.0f), zero = splat<V>(0.0f);
        const Vec3<V> other = {select(least, one, zero), select(least, zero, one), zero};
        normal = select(in_line, cross(near, other), normal);
        length = root(dot(normal, normal));
    }
    return (1.0f / larger(length, splat<V>(TINY * TINY))) * normal;
}

// Bend round a circle, in its plane; returns in which worlds, and leaves no meaning in the others.
template <class V, class M>
INLINE M bend_outside(M bent, Vec3<V> near, Vec3<V> far, Vec3<V> normal, Vec3<V> side, bool has_side,
                      V radius, Bend<V>& bend) {
    const V near2 = dot(near, near), far2 = dot(far, far), radius2 = radius * radius;
    const Vec3<V> step = far - near;
    const V step2 = dot(step, step);
    bent = bent & (near2 >= radius2) & (far2 >= radius2) & (radius >= TINY) & (step2 >= TINY);
    if (!any(bent))
        return bent;
    V turn = dot(normal, cross(near, step));
    M encloses = step2 < 0.0f;
    if (has_side) {
        const V to_side = dot(normal, cross(near, side)), from_side = dot(normal, cross(side, far));
        encloses = ((to_side > 0.0f) & (from_side > 0.0f) & (turn <= 0.0f)) |
                   ((to_side < 0.0f) & (from_side < 0.0f) & (turn >= 0.0f));
        turn = select(encloses, to_side, turn);
    }
    const V along = -dot(step, near);
    bent = bent & (encloses | ((along > 0.0f) & (along < step2) & (turn * turn <= radius2 * step2)));
    if (!any(bent))
        return bent;
    const V sign = select(turn < 0.0f, splat<V>(-1.0f), splat<V>(1.0f));
    const V near_tangent = root(near2 - radius2), far_tangent = root(far2 - radius2);
    bend.onto = (1.0f / near2) * ((sign * radius) * cross(normal, near) - near_tangent * near);
    bend.off = (1.0f / far2) * ((sign * radius) * cross(normal, far) + far_tangent * far);
    const V arc = arctan2(sign * dot(normal, cross(bend.onto, bend.off)), dot(bend.onto, bend.off));
    const M over = arc < 0.0f;
    bend.length = near_tangent + radius * select(over, arc + 6.28318531f, arc) + far_tangent;
    return bent & (opposite(over) | encloses);
}

// Add -d |end - point| / dangle and its derivative, for a point of the unit circle.
template <class V> INLINE void lean(V end_x, V end_y, V x, V y, V& slope, V& curve) {
    const V dx = end_x - x, dy = end_y - y;
    const V inverse = 1.0f / root(dx * dx + dy * dy);
    const V along = inverse * (end_y * x - end_x * y);
    slope += along;
    curve += inverse * (along * along - (x * end_x + y * end_y));
}

// The point of the unit circle over which (near, 0) and far are closest, from one that both ends see: as
// long as they do, the way over it is convex in its angle, and Newton's method finds it. Where an end all
// but lies on the circle, halving what lies between both ends does.
template <class V, class M> INLINE void touch_inside(M busy, V near, V far_x, V far_y, V& x, V& y) {
    for (int i = 0; i < NEWTON_STEPS && any(busy); ++i) {
        V slope = splat<V>(0.0f), curve = slope;
        lean(near, splat<V>(0.0f), x, y, slope, curve);
        lean(far_x, far_y, x, y, slope, curve);
        const V turn = slope / larger(-curve, splat<V>(TINY));
        const V half = 0.5f * larger(splat<V>(-1.0f), smaller(splat<V>(1.0f), turn));
        const V scale = 1.0f / (1.0f + half * half), cosine = (1.0f - half * half) * scale;  // without a root
        const V sine = 2.0f * half * scale, turned_x = cosine * x - sine * y;
        y = select(busy, cosine * y + sine * x, y);
        x = select(busy, turned_x, x);
        busy = busy & (absolute(turn) >= STILL);
    }
    if (!any(busy))
        return;
    const V inverse = 1.0f / root(far_x * far_x + far_y * far_y);
    V low_x = splat<V>(1.0f), low_y = splat<V>(0.0f), high_x = far_x * inverse, high_y = far_y * inverse;
    for (int i = 0; i < HALVINGS; ++i) {
        V slope = splat<V>(0.0f), curve = slope;
        const V sum_x = low_x + high_x, sum_y = low_y + high_y;
        const V scale = 1.0f / root(sum_x * sum_x + sum_y * sum_y), middle_x = scale * sum_x;
        const V middle_y = scale * sum_y;
        lean(near, splat<V>(0.0f), middle_x, middle_y, slope, curve);
        lean(far_x, far_y, middle_x, middle_y, slope, curve);
        const M unseen = middle_x * far_x + middle_y * far_y <= 1.0f;
        const M onward = (middle_x * near > 1.0f) & (unseen | (slope * far_y > 0.0f));
        low_x = select(onward, middle_x, low_x), low_y = select(onward, middle_y, low_y);
        high_x = select(onward, high_x, middle_x), high_y = select(onward, high_y, middle_y);
    }
    x = select(busy, low_x, x);
    y = select(busy, low_y, y);
}

// Bend over the inside of a circle, in its plane; straight where the segment cuts the circle.
template <class V, class M>
INLINE M bend_inside(M bent, Vec3<V> near, Vec3<V> far, Vec3<V> normal, V radius, Bend<V>& bend) {
    const V distance = root(dot(near, near));
    bent = bent & (radius >= TINY) & (distance > radius) & (dot(far, far) > radius * radius);
    if (!any(bent))
        return bent;
    const V inverse = 1.0f / radius, near_x = distance * inverse;
    const Vec3<V> first = (1.0f / distance) * near, second = cross(normal, first);
    const V far_x = dot(far, first) * inverse, far_y = dot(far, second) * inverse, step = far_x - near_x;
    const V share = -near_x * step / larger(step * step + far_y * far_y, splat<V>(TINY));
    const V part = larger(splat<V>(0.0f), smaller(splat<V>(1.0f), share));
    V x = near_x + part * step, y = part * far_y;  // of the segment, nearest to the centre
    const V square = x * x + y * y, scale = 1.0f / root(square);
    bent = bent & (square > 1.0f);
    x *= scale;
    y *= scale;
    touch_inside(bent, near_x, far_x, far_y, x, y);
    const Vec3<V> touch = (radius * x) * first + (radius * y) * second;
    const Vec3<V> onto = touch - near, off = far - touch;
    const V onto_length = root(dot(onto, onto)), off_length = root(dot(off, off));
    bend.length = select(bent, onto_length + off_length, bend.length);
    bend.onto = select(bent, unit(onto, onto_length), bend.onto);
    bend.off = select(bent, unit(off, off_length), bend.off);
    return bent;
}

// Bend round a geom; points relative to its centre, `axis` is the cylinder's.
template <class V>
INLINE typename MaskOf<V>::type bend_round(int kind, Vec3<V> near, Vec3<V> far, Vec3<V> axis, Vec3<V> side,
                                           bool has_side, V radius, Bend<V>& bend) {
    typedef typename MaskOf<V>::type M;
    Vec3<V> normal = axis;
    V rise = splat<V>(0.0f);
    if (kind == CYLINDER) {
        const V low = dot(near, axis), high = dot(far, axis);
        near = near - low * axis;
        far = far - high * axis;
        rise = high - low;
    } else {
        normal = sphere_normal(near, far);
    }
    const V square = dot(side, side);
    const M inside = has_side ? square < radius * radius : square < 0.0f, outside = opposite(inside);
    M bent = inside & outside;
    if (any(outside))
        bent = bend_outside(outside, near, far, normal, side, has_side, radius, bend);
    if (any(inside))
        bent = bent | bend_inside(inside, near, far, normal, radius, bend);
    if (kind == CYLINDER && any(bent)) {  // its path rises at one slope from end to end
        const V length = root(bend.length * bend.length + rise * rise), inverse = 1.0f / length;
        bend.onto = (bend.length * inverse) * bend.onto + (rise * inverse) * axis;
        bend.off = (bend.length * inverse) * bend.off + (rise * inverse) * axis;
        bend.length = length;
    }
    return bent;
}

// Follow every `stride`th path from `first` on, and give actuators on joints what is theirs.
template <class V, class Program, class State, class Pose, class Moving, class Transmission>
void follow_block(Block<V>& block, int first, int stride, Program& program, State& qpos, State& qvel,
                  Pose& pose, Moving& motion, Transmission& transmission) {
    const V* angle = block.in(qpos);
    const V* speed = block.in(qvel);
    const Vec3<V>* position = (const Vec3<V>*)block.in(pose.xpos);
    const Mat33<V>* frame = (const Mat33<V>*)block.in(pose.xmat);
    const Vec3<V>* geom_position = (const Vec3<V>*)block.in(pose.geom_xpos);
    const Mat33<V>* geom_frame = (const Mat33<V>*)block.in(pose.geom_xmat);
    const Vec3<V>* com = (const Vec3<V>*)block.in(motion.subtree_com);
    const Motion<V>* dof = (const Motion<V>*)block.in(motion.cdof);
    const Field<V> sites = block.model(program.site_pos), sizes = block.model(program.geom_size);
    const Field<V> gears = block.model(program.actuator_gear);
    V* lengths = block.template out<V>(transmission.ten_length);
    V* moments = block.template out<V>(transmission.ten_J);
    V* actuator_length = block.template out<V>(transmission.actuator_length);
    V* actuator_velocity = block.template out<V>(transmission.actuator_velocity);
    V* actuator_moment = block.template out<V>(transmission.actuator_moment);
    const V zero = splat<V>(0.0f);
    const Vec3<V> none = {zero, zero, zero};

    auto at = [&](int body, int site) { return position[body] + mul(frame[body], sites.vec3(site)); };
    auto add = [&](const auto& link, Vec3<V> point, Vec3<V> force) {
        if (link.first < link.middle) {
            const Motion<V> wrench = {cross(point - com[link.near_root], force), force};
            for (int i = link.first; i < link.middle; ++i) {
                const auto& crossing = program.crossings.data[i];
                moments[crossing[1]] -= dot(dof[crossing[0]], wrench);
            }
        }
        if (link.middle < link.last) {
            const Motion<V> wrench = {cross(point - com[link.far_root], force), force};
            for (int i = link.middle; i < link.last; ++i) {
                const auto& crossing = program.crossings.data[i];
                moments[crossing[1]] += dot(dof[crossing[0]], wrench);
            }
        }
    };
    for (int p = first; p < program.paths.shape[0]; p += stride) {
        const auto& path = program.paths.data[p];
        for (int entry = path.row; entry < path.row + path.num_dofs; ++entry)
            moments[entry] = zero;
        V length = splat<V>(path.fixed_length);
        int last_site = -1;
        Vec3<V> far = none;
        for (int i = path.first_op; i < path.last_op; ++i) {
            const auto& op = program.ops.data[i];
            const V scale = splat<V>(op.scale);
            const Vec3<V> near = op.near_site == last_site ? far : at(op.near_body, op.near_site);
            far = at(op.far_body, op.far_site);
            last_site = op.far_site;
            Bend<V> bend = {zero, none, none};
            auto bent = zero < zero;
            if (op.kind != STRAIGHT) {
                const Vec3<V> centre = geom_position[op.geom];
                const Mat33<V>& turned = geom_frame[op.geom];
                const bool has_side = op.side_site >= 0;
                const Vec3<V> side = has_side ? at(op.side_body, op.side_site) - centre : none;
                const Vec3<V> axis = {turned.m[0][2], turned.m[1][2], turned.m[2][2]};
                const V radius = sizes[3 * op.geom];
                bent = bend_round(op.kind, near - centre, far - centre, axis, side, has_side, radius, bend);
            }
            // Where worlds differ both ways are added, each with no force in the worlds of the other.
            if (any(bent)) {
                length += scale * select(bent, bend.length, zero);
                add(op.onto, near, scale * select(bent, bend.onto, none));
                add(op.off, far, scale * select(bent, bend.off, none));
            }
            const auto straight = opposite(bent);
            if (any(straight)) {
                const Vec3<V> step = far - near;
                const V distance = root(dot(step, step));
                length += scale * select(straight, distance, zero);
                add(op.direct, near, scale * select(straight, unit(step, distance), none));
            }
        }
        lengths[p] = length;
        for (int i = path.first_drive; i < path.last_drive; ++i) {
            const auto& drive = program.drives.data[i];
            const V gear = gears[6 * drive.actuator];
            V velocity = zero;
            for (int k = 0; k < path.num_dofs; ++k) {
                const V moment = actuator_moment[drive.row + k] = gear * moments[path.row + k];
                velocity += moment * speed[program.dofs.data[path.row + k]];
            }
            actuator_length[drive.actuator] = gear * length;
            actuator_velocity[drive.actuator] = velocity;
        }
    }
    for (int i = program.first_joint_drive + first; i < program.drives.shape[0]; i += stride) {
        const auto& drive = program.drives.data[i];
        const V gear = actuator_moment[drive.row] = gears[6 * drive.actuator];
        actuator_length[drive.actuator] = gear * angle[drive.qpos];
        actuator_velocity[drive.actuator] = gear * speed[drive.dof];
    }
    block.store(transmission.ten_length, lengths, 0, program.paths.shape[0]);
    block.store(transmission.ten_J, moments, 0, program.dofs.shape[0]);
    block.store(transmission.actuator_length, actuator_length, 0, program.drives.shape[0]);
    block.store(transmission.actuator_velocity, actuator_velocity, 0, program.drives.shape[0]);
    block.store(transmission.actuator_moment, actuator_moment, 0, program.num_moments);
}
}  // namespace lanes
