// Body of the native function `move_worlds` (rigid_body.py, which explains the method). Quaternions have their
// real part first, as in MuJoCo; motions and forces have their angular part first.

struct Quat { float w, x, y, z; };
struct Motion { wp::vec3 angular, linear; };
struct Inertia { float xx, yy, zz, xy, xz, yz; wp::vec3 moment; float mass; };
enum { FREE, BALL, SLIDE, HINGE };
constexpr float TINY = 1e-15f;

auto multiply = [](const Quat& a, const Quat& b) -> Quat {
    return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
};
auto is_identity = [](const Quat& q) { return q.w == 1.0f && q.x == 0.0f && q.y == 0.0f && q.z == 0.0f; };
auto normalized = [](const Quat& q) -> Quat {
    const float square = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
    const float scale = square > 0.0f ? 1.0f / sqrtf(square) : 0.0f;
    return {q.w * scale, q.x * scale, q.y * scale, q.z * scale};
};
auto matrix = [](const Quat& q) {
    const float ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    const float wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z, xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
    return wp::mat33(ww + xx - yy - zz, 2.0f * (xy - wz), 2.0f * (xz + wy),  //
                     2.0f * (xy + wz), ww - xx + yy - zz, 2.0f * (yz - wx),  //
                     2.0f * (xz - wy), 2.0f * (yz + wx), ww - xx - yy + zz);
};
auto rotate = [](const Quat& q, const wp::vec3& v) {
    const wp::vec3 u(q.x, q.y, q.z);
    return 2.0f * (wp::dot(u, v) * u) + (q.w * q.w - wp::dot(u, u)) * v + 2.0f * q.w * wp::cross(u, v);
};
auto about = [](const wp::vec3& axis, float angle) -> Quat {
    const float s = sinf(0.5f * angle);
    return {cosf(0.5f * angle), s * axis[0], s * axis[1], s * axis[2]};
};
auto dot = [](const Motion& a, const Motion& b) {
    return wp::dot(a.angular, b.angular) + wp::dot(a.linear, b.linear);
};
auto add = [](Motion& to, const Motion& motion, float factor) {
    to.angular += factor * motion.angular;
    to.linear += factor * motion.linear;
};
auto times = [](const Inertia& I, const Motion& v) -> Motion {
    const wp::vec3 &a = v.angular, &l = v.linear;
    const wp::vec3 Ia(I.xx * a[0] + I.xy * a[1] + I.xz * a[2], I.xy * a[0] + I.yy * a[1] + I.yz * a[2],
                      I.xz * a[0] + I.yz * a[1] + I.zz * a[2]);
    return {Ia + wp::cross(I.moment, l), I.mass * l + wp::cross(a, I.moment)};
};
auto cross_motion = [](const Motion& v, const Motion& m) -> Motion {
    return {wp::cross(v.angular, m.angular), wp::cross(v.linear, m.angular) + wp::cross(v.angular, m.linear)};
};
auto cross_force = [](const Motion& v, const Motion& f) -> Motion {
    return {wp::cross(v.angular, f.angular) + wp::cross(v.linear, f.linear), wp::cross(v.angular, f.linear)};
};
const auto num_bodies = bodies.body_parentid.shape[0], num_joints = bodies.jnt_type.shape[0];
const int* parent = bodies.body_parentid.data;
const int* root = bodies.body_rootid.data;
const int* joint_kind = bodies.jnt_type.data;
const int* first_dof = bodies.jnt_dofadr.data;
auto dofs_of = [](int kind) { return kind == FREE ? 6 : kind == BALL ? 3 : 1; };

for (int world = thread; world < qpos.shape[0]; world += threads) {
    if (!mask.data[world])
        continue;
    // A world's row of an array of the model, which has one for all worlds or one for each, and of the state.
    auto model = [&](auto& rows) { return &wp::index(rows, rows.shape[0] > 1 ? world % rows.shape[0] : 0, 0); };
    auto state = [&](auto& array) { return &wp::index(array, world, 0); };
    // Poses.
    const float* angle = state(qpos);
    const float* angle0 = model(bodies.qpos0);
    wp::vec3* position = state(pose.xpos);
    Quat* orientation = (Quat*)state(pose.xquat);
    wp::mat33* frame = state(pose.xmat);
    wp::vec3* anchor = state(pose.xanchor);
    wp::vec3* axis = state(pose.xaxis);
    const wp::vec3* joint_position = model(bodies.jnt_pos);
    const wp::vec3* joint_axis = model(bodies.jnt_axis);
    const wp::vec3* body_position = model(bodies.body_pos);
    const Quat* body_orientation = (const Quat*)model(bodies.body_quat);
    frame[0] = matrix(orientation[0]);
    for (int b = 1; b < num_bodies; ++b) {
        const int begin = bodies.body_jntadr.data[b], end = begin + bodies.body_jntnum.data[b];
        const int mocap = bodies.body_mocapid.data[b], p = parent[b];
        wp::vec3 x;
        Quat q;
        if (end > begin && joint_kind[begin] == FREE) {
            const float* free = angle + bodies.jnt_qposadr.data[begin];
            position[b] = anchor[begin] = wp::vec3(free[0], free[1], free[2]);
            axis[begin] = joint_axis[begin];
            orientation[b] = normalized({free[3], free[4], free[5], free[6]});
            frame[b] = matrix(orientation[b]);
            continue;
        }
        if (mocap >= 0) {
            x = position[p] + wp::mul(frame[p], state(pose.mocap_pos)[mocap]);
            q = multiply(orientation[p], ((Quat*)state(pose.mocap_quat))[mocap]);
        } else {
            x = position[p] + wp::mul(frame[p], body_position[b]);
            q = is_identity(body_orientation[b]) ? orientation[p] : multiply(orientation[p], body_orientation[b]);
        }
        for (int j = begin; j < end; ++j) {
            const int at = bodies.jnt_qposadr.data[j];
            const bool central = joint_position[j] == wp::vec3();  // as most are
            anchor[j] = central ? x : x + rotate(q, joint_position[j]);
            axis[j] = rotate(q, joint_axis[j]);
            if (joint_kind[j] == SLIDE) {
                x += (angle[at] - angle0[at]) * axis[j];
                continue;
            }
            const Quat turn = joint_kind[j] == HINGE
                                  ? about(joint_axis[j], angle[at] - angle0[at])
                                  : normalized({angle[at], angle[at + 1], angle[at + 2], angle[at + 3]});
            q = multiply(q, turn);
            if (!central)
                x = anchor[j] - rotate(q, joint_position[j]);
        }
        position[b] = x;
        orientation[b] = normalized(q);
        frame[b] = matrix(orientation[b]);
    }
    // Frames fixed to bodies: of sites, of mass, of geoms.
    auto place = [&](int b, int i, const wp::vec3* offset, const Quat* turn, wp::vec3* x, wp::mat33* R) {
        x[i] = position[b] + wp::mul(frame[b], offset[i]);
        R[i] = matrix(multiply(orientation[b], turn[i]));
    };
    wp::vec3* site_position = state(pose.site_xpos);
    wp::mat33* site_frame = state(pose.site_xmat);
    const wp::vec3* site_offset = model(bodies.site_pos);
    const Quat* site_turn = (const Quat*)model(bodies.site_quat);
    for (int k = 0; k < sites.shape[0]; ++k) {
        const int s = sites.data[k];
        place(bodies.site_bodyid.data[s], s, site_offset, site_turn, site_position, site_frame);
    }
    if (!switches.dynamics)
        continue;
    wp::vec3* center = state(pose.xipos);
    wp::mat33* principal = state(pose.ximat);
    const wp::vec3* center_offset = model(bodies.body_ipos);
    const Quat* principal_turn = (const Quat*)model(bodies.body_iquat);
    for (int b = 0; b < num_bodies; ++b)
        place(b, b, center_offset, principal_turn, center, principal);
    wp::vec3* geom_position = state(pose.geom_xpos);
    wp::mat33* geom_frame = state(pose.geom_xmat);
    const wp::vec3* geom_offset = model(bodies.geom_pos);
    const Quat* geom_turn = (const Quat*)model(bodies.geom_quat);
    for (int g = 0; g < bodies.geom_bodyid.shape[0]; ++g) {
        const int b = bodies.geom_bodyid.data[g];
        if (bodies.body_weldid.data[b] != 0 || bodies.body_mocapid.data[root[b]] != -1)  // others never move
            place(b, g, geom_offset, geom_turn, geom_position, geom_frame);
    }

    // Centres of mass of subtrees, and inertias about those of whole trees.
    const float* mass = model(bodies.body_mass);
    const float* subtree_mass = model(bodies.body_subtreemass);
    wp::vec3* com = state(motion.subtree_com);
    Inertia* inertia = (Inertia*)state(motion.cinert);
    Inertia* composite = (Inertia*)state(motion.crb);
    for (int b = 0; b < num_bodies; ++b)
        com[b] = mass[b] * center[b];
    for (int b = num_bodies - 1; b > 0; --b)
        com[parent[b]] += com[b];
    for (int b = 0; b < num_bodies; ++b)
        com[b] = subtree_mass[b] < TINY ? center[b] : com[b] / subtree_mass[b];
    const wp::vec3* principal_inertia = model(bodies.body_inertia);
    for (int b = 0; b < num_bodies; ++b) {
        const wp::mat33 R = principal[b];
        const wp::vec3 d = center[b] - com[root[b]], diagonal = principal_inertia[b];
        auto moment = [&](int i, int j) {
            float sum = -mass[b] * d[i] * d[j];
            for (int k = 0; k < 3; ++k)
                sum += R.data[i][k] * diagonal[k] * R.data[j][k];
            return sum;
        };
        const float shift = mass[b] * wp::dot(d, d);
        inertia[b] = {shift + moment(0, 0), shift + moment(1, 1), shift + moment(2, 2), moment(0, 1),
                      moment(0, 2), moment(1, 2), mass[b] * d, mass[b]};
        composite[b] = inertia[b];
    }
    for (int b = num_bodies - 1; b > 0; --b) {
        if (parent[b] == 0)
            continue;
        const float* from = (const float*)&composite[b];
        float* to = (float*)&composite[parent[b]];
        for (int k = 0; k < 10; ++k)
            to[k] += from[k];
    }

    // Motions of the degrees of freedom, velocities, and their change with the bodies' own motion.
    const float* speed = state(qvel);
    Motion* dof = (Motion*)state(motion.cdof);
    Motion* dof_change = (Motion*)state(motion.cdof_dot);
    Motion* velocity = (Motion*)state(motion.cvel);
    Motion* acceleration = (Motion*)state(motion.cacc);
    velocity[0] = {};
    acceleration[0] = {};
    if (switches.has_gravity)
        acceleration[0].linear = -bodies.gravity.data[world % bodies.gravity.shape[0]];
    for (int b = 1; b < num_bodies; ++b) {
        Motion v = velocity[parent[b]], a = acceleration[parent[b]];
        const int begin = bodies.body_jntadr.data[b], end = begin + bodies.body_jntnum.data[b];
        for (int j = begin; j < end; ++j) {
            const wp::vec3 arm = com[root[b]] - anchor[j];
            int i = first_dof[j];
            if (joint_kind[j] == HINGE) {
                dof[i] = {axis[j], wp::cross(axis[j], arm)};
            } else if (joint_kind[j] == SLIDE) {
                dof[i] = {wp::vec3(), axis[j]};
            } else {
                if (joint_kind[j] == FREE) {  // its translation comes first, and is along the world's axes
                    for (int k = 0; k < 3; ++k, ++i) {
                        dof[i] = dof_change[i] = {};
                        dof[i].linear[k] = 1.0f;
                        add(v, dof[i], speed[i]);
                    }
                }
                for (int k = 0; k < 3; ++k) {
                    const wp::vec3 column(frame[b].data[0][k], frame[b].data[1][k], frame[b].data[2][k]);
                    dof[i + k] = {column, wp::cross(column, arm)};
                }
            }
            const int last = first_dof[j] + dofs_of(joint_kind[j]);
            for (int k = i; k < last; ++k) {
                dof_change[k] = cross_motion(v, dof[k]);
                add(a, dof_change[k], speed[k]);
            }
            for (int k = i; k < last; ++k)
                add(v, dof[k], speed[k]);
        }
        velocity[b] = v;
        acceleration[b] = a;
    }

    // M_ij = dof_i' (composite inertia of i's body) dof_j, for i and the dofs that carry it.
    const float* armature = model(bodies.dof_armature);
    float* M = state(motion.M);
    for (int i = 0; i < bodies.dof_bodyid.shape[0]; ++i) {
        const Motion momentum = times(composite[bodies.dof_bodyid.data[i]], dof[i]);
        const int begin = bodies.M_rowadr.data[i];
        int entry = begin + bodies.M_rownnz.data[i] - 1;
        M[entry] = armature[i] + dot(dof[i], momentum);
        for (int j = bodies.dof_parentid.data[i]; j >= 0 && entry > begin; j = bodies.dof_parentid.data[j])
            M[--entry] = dot(dof[j], momentum);
    }

    // Bias: what the bodies' accelerations without any qacc take, summed over subtrees.
    Motion* force = (Motion*)state(motion.cfrc_int);
    float* bias = state(motion.qfrc_bias);
    force[0] = {};
    for (int b = 1; b < num_bodies; ++b) {
        force[b] = times(inertia[b], acceleration[b]);
        add(force[b], cross_force(velocity[b], times(inertia[b], velocity[b])), 1.0f);
    }
    for (int b = num_bodies - 1; b > 0; --b)
        add(force[parent[b]], force[b], 1.0f);
    for (int i = 0; i < bodies.dof_bodyid.shape[0]; ++i)
        bias[i] = dot(dof[i], force[bodies.dof_bodyid.data[i]]);

    // Springs and dampers of joints, whose coefficients may grow with the deflection and the speed.
    const float* rest = model(bodies.qpos_spring);
    const float* stiffness = model(bodies.jnt_stiffness);
    const float* damping = model(bodies.dof_damping);
    const wp::vec2* more_stiffness = model(bodies.jnt_stiffnesspoly);
    const wp::vec2* more_damping = model(bodies.dof_dampingpoly);
    float* spring = state(motion.qfrc_spring);
    float* damper = state(motion.qfrc_damper);
    float* passive = state(motion.qfrc_passive);
    auto coefficient = [](float linear, const wp::vec2& more, float x) {
        return linear + more[0] * x + more[1] * x * x;
    };
    for (int j = 0; j < num_joints; ++j) {
        const int begin = first_dof[j], end = begin + dofs_of(joint_kind[j]);
        for (int i = begin; i < end; ++i) {
            spring[i] = 0.0f;
            const float drag = coefficient(damping[i], more_damping[i], fabsf(speed[i]));
            damper[i] = switches.has_dampers ? -speed[i] * drag : 0.0f;
        }
        if (switches.has_springs && joint_kind[j] >= SLIDE) {
            const float x = angle[bodies.jnt_qposadr.data[j]] - rest[bodies.jnt_qposadr.data[j]];
            spring[begin] = -x * coefficient(stiffness[j], more_stiffness[j], x);
        }
        for (int i = begin; i < end; ++i)
            passive[i] = spring[i] + damper[i];
    }
}
