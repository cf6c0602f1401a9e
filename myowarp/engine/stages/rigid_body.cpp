// Rigid bodies of the worlds of a block (rigid_body.py explains the method, lanes.cpp what V is). Quaternions
// have their real part first, as in MuJoCo; motions and forces have their angular part first.
namespace lanes {

template <class V> struct Inertia { V xx, yy, zz, xy, xz, yz; Vec3<V> moment; V mass; };

template <class V> INLINE void add(Motion<V>& to, const Motion<V>& motion, V factor) {
    to.angular = to.angular + factor * motion.angular;
    to.linear = to.linear + factor * motion.linear;
}
template <class V> INLINE Motion<V> times(const Inertia<V>& I, const Motion<V>& v) {
    const Vec3<V>&a = v.angular, &l = v.linear;
    const Vec3<V> Ia = {I.xx * a.x + I.xy * a.y + I.xz * a.z, I.xy * a.x + I.yy * a.y + I.yz * a.z,
                        I.xz * a.x + I.yz * a.y + I.zz * a.z};
    return {Ia + cross(I.moment, l), I.mass * l + cross(a, I.moment)};
}
template <class V> INLINE Motion<V> cross_motion(const Motion<V>& v, const Motion<V>& m) {
    return {cross(v.angular, m.angular), cross(v.linear, m.angular) + cross(v.angular, m.linear)};
}
template <class V> INLINE Motion<V> cross_force(const Motion<V>& v, const Motion<V>& f) {
    return {cross(v.angular, f.angular) + cross(v.linear, f.linear), cross(v.angular, f.linear)};
}
INLINE int dofs_of(int kind) { return kind == FREE ? 6 : kind == BALL ? 3 : 1; }

// Poses and motions of the bodies of a block's worlds, found one after the other.
template <class V, class Bodies, class Switches, class Pose, class Moving> struct Mover {
    Block<V>& block;
    Bodies& bodies;
    Switches& switches;
    Pose& pose;
    Moving& motion;
    const int num_bodies = bodies.body_parentid.shape[0], num_joints = bodies.jnt_type.shape[0];
    const int num_dofs = bodies.dof_bodyid.shape[0];
    const int *parent = bodies.body_parentid.data, *root = bodies.body_rootid.data;
    const int *joint_kind = bodies.jnt_type.data, *first_dof = bodies.jnt_dofadr.data;
    const V zero = splat<V>(0.0f), one = splat<V>(1.0f);
    const Vec3<V> origin = {zero, zero, zero};
    const bool last = switches.remaining.shape[0] == 0 || switches.remaining.data[0] <= 1;
    const bool touches = switches.has_contacts;
    const V *angle, *speed;
    Vec3<V>*position, *anchor, *axis, *center, *com;
    Quat<V>* orientation;
    Mat33<V>*frame, *principal;
    Inertia<V>*inertia, *composite;
    Motion<V>*dof, *dof_change, *velocity, *acceleration, *force;
    V *M, *bias, *spring, *damper, *passive;

    template <class A, class T>
    __attribute__((always_inline)) void store(A& array, const T* from, bool wanted = true) {
        if (wanted)
            block.store(array, (const V*)from, 0, row_floats(array));
    }
    static Quat<V> quaternion(const V* q) { return {q[0], q[1], q[2], q[3]}; }

    template <class State> __attribute__((always_inline)) void pose_bodies(State& qpos) {
        angle = block.in(qpos);
        const Field<V> angle0 = block.model(bodies.qpos0);
        position = block.template out<Vec3<V>>(pose.xpos);
        orientation = block.template out<Quat<V>>(pose.xquat);
        frame = block.template out<Mat33<V>>(pose.xmat);
        anchor = block.template out<Vec3<V>>(pose.xanchor);
        axis = block.template out<Vec3<V>>(pose.xaxis);
        const Field<V> joint_position = block.model(bodies.jnt_pos);
        const Field<V> joint_axis = block.model(bodies.jnt_axis);
        const Field<V> body_position = block.model(bodies.body_pos);
        const Field<V> body_orientation = block.model(bodies.body_quat);
        const V* mocap_position = block.in(pose.mocap_pos);
        const V* mocap_orientation = block.in(pose.mocap_quat);
        position[0] = origin;
        orientation[0] = {one, zero, zero, zero};
        frame[0] = matrix(orientation[0]);
        for (int b = 1; b < num_bodies; ++b) {
            const int begin = bodies.body_jntadr.data[b], end = begin + bodies.body_jntnum.data[b];
            const int mocap = bodies.body_mocapid.data[b], p = parent[b];
            Vec3<V> x;
            Quat<V> q;
            if (end > begin && joint_kind[begin] == FREE) {
                const V* free = angle + bodies.jnt_qposadr.data[begin];
                position[b] = anchor[begin] = {free[0], free[1], free[2]};
                axis[begin] = joint_axis.vec3(begin);
                orientation[b] = normalized(quaternion(free + 3));
                frame[b] = matrix(orientation[b]);
                continue;
            }
            if (mocap >= 0) {
                x = position[p] + mul(frame[p], ((const Vec3<V>*)mocap_position)[mocap]);
                q = multiply(orientation[p], ((const Quat<V>*)mocap_orientation)[mocap]);
            } else {
                x = position[p] + mul(frame[p], body_position.vec3(b));
                const bool untwisted = body_orientation.is(b, 4, 1.0f);
                q = untwisted ? orientation[p] : multiply(orientation[p], body_orientation.quat(b));
            }
            for (int j = begin; j < end; ++j) {
                const int at = bodies.jnt_qposadr.data[j];
                const bool central = joint_position.is(j, 3, 0.0f);  // as most are
                const Vec3<V> joint_at = joint_position.vec3(j), joint_along = joint_axis.vec3(j);
                anchor[j] = central ? x : x + rotate(q, joint_at);
                axis[j] = rotate(q, joint_along);
                if (joint_kind[j] == SLIDE) {
                    x = x + (angle[at] - angle0[at]) * axis[j];
                    continue;
                }
                Quat<V> turn;
                if (joint_kind[j] == HINGE) {
                    V sine;
                    sine_cosine(0.5f * (angle[at] - angle0[at]), sine, turn.w);
                    turn.x = sine * joint_along.x;
                    turn.y = sine * joint_along.y, turn.z = sine * joint_along.z;
                } else {
                    turn = normalized(quaternion(angle + at));
                }
                q = multiply(q, turn);
                if (!central)
                    x = anchor[j] - rotate(q, joint_at);
            }
            position[b] = x;
            orientation[b] = normalized(q);
            frame[b] = matrix(orientation[b]);
        }
    }

    // A frame fixed to a body.
    __attribute__((always_inline)) void place(int b, int i, const Field<V>& offset, const Field<V>& turn,
                                              Vec3<V>* x, Mat33<V>* R) {
        x[i] = position[b] + mul(frame[b], offset.vec3(i));
        R[i] = matrix(multiply(orientation[b], turn.quat(i)));
    }

    template <class Sites> __attribute__((always_inline)) void place_sites(Sites& sites) {
        Vec3<V>* site_position = block.template out<Vec3<V>>(pose.site_xpos);
        Mat33<V>* site_frame = block.template out<Mat33<V>>(pose.site_xmat);
        const Field<V> site_offset = block.model(bodies.site_pos);
        const Field<V> site_turn = block.model(bodies.site_quat);
        for (int k = 0; k < sites.shape[0]; ++k) {
            const int s = sites.data[k];
            place(bodies.site_bodyid.data[s], s, site_offset, site_turn, site_position, site_frame);
            block.store(pose.site_xpos, (const V*)site_position, 3 * s, 3 * s + 3);
            block.store(pose.site_xmat, (const V*)site_frame, 9 * s, 9 * s + 9);
        }
    }

    __attribute__((always_inline)) void place_masses() {
        center = block.template out<Vec3<V>>(pose.xipos);
        principal = block.template out<Mat33<V>>(pose.ximat);
        const Field<V> center_offset = block.model(bodies.body_ipos);
        const Field<V> principal_turn = block.model(bodies.body_iquat);
        for (int b = 0; b < num_bodies; ++b)
            place(b, b, center_offset, principal_turn, center, principal);
    }

    __attribute__((always_inline)) void place_geoms() {
        Vec3<V>* geom_position = block.template out<Vec3<V>>(pose.geom_xpos);
        Mat33<V>* geom_frame = block.template out<Mat33<V>>(pose.geom_xmat);
        const Field<V> geom_offset = block.model(bodies.geom_pos);
        const Field<V> geom_turn = block.model(bodies.geom_quat);
        const int num_geoms = bodies.geom_bodyid.shape[0];
        auto moves = [&](int g) {  // others never do
            const int b = bodies.geom_bodyid.data[g];
            return bodies.body_weldid.data[b] != 0 || bodies.body_mocapid.data[root[b]] != -1;
        };
        for (int g = 0; g < num_geoms; ++g) {
            const int begin = g;
            for (; g < num_geoms && moves(g); ++g)
                place(bodies.geom_bodyid.data[g], g, geom_offset, geom_turn, geom_position, geom_frame);
            if (last || touches) {
                block.store(pose.geom_xpos, (const V*)geom_position, 3 * begin, 3 * g);
                block.store(pose.geom_xmat, (const V*)geom_frame, 9 * begin, 9 * g);
            }
            if (g < num_geoms) {  // for paths round it
                block.load(pose.geom_xpos, (V*)geom_position, 3 * g, 3 * g + 3);
                block.load(pose.geom_xmat, (V*)geom_frame, 9 * g, 9 * g + 9);
            }
        }
    }

    // Centres of mass of subtrees, and inertias about those of whole trees.
    __attribute__((always_inline)) void find_inertias() {
        const Field<V> mass = block.model(bodies.body_mass);
        const Field<V> subtree_mass = block.model(bodies.body_subtreemass);
        com = block.template out<Vec3<V>>(motion.subtree_com);
        inertia = block.template out<Inertia<V>>(motion.cinert);
        composite = block.template out<Inertia<V>>(motion.crb);
        for (int b = 0; b < num_bodies; ++b)
            com[b] = mass[b] * center[b];
        for (int b = num_bodies - 1; b > 0; --b)
            com[parent[b]] = com[parent[b]] + com[b];
        for (int b = 0; b < num_bodies; ++b) {
            const V whole = subtree_mass[b];
            const Vec3<V> m = com[b];
            com[b] = select(whole < TINY, center[b], Vec3<V>{m.x / whole, m.y / whole, m.z / whole});
        }
        const Field<V> principal_inertia = block.model(bodies.body_inertia);
        for (int b = 0; b < num_bodies; ++b) {
            const Mat33<V> R = principal[b];
            const Vec3<V> offset = center[b] - com[root[b]];
            const V d[3] = {offset.x, offset.y, offset.z}, m = mass[b];
            const Vec3<V> moments = principal_inertia.vec3(b);
            const V diagonal[3] = {moments.x, moments.y, moments.z};
            auto moment = [&](int i, int j) {
                V sum = -m * d[i] * d[j];
#pragma unroll
                for (int k = 0; k < 3; ++k)
                    sum += R.m[i][k] * diagonal[k] * R.m[j][k];
                return sum;
            };
            const V shift = m * dot(offset, offset);
            inertia[b] = {shift + moment(0, 0), shift + moment(1, 1), shift + moment(2, 2), moment(0, 1),
                          moment(0, 2), moment(1, 2), m * offset, m};
            composite[b] = inertia[b];
        }
        for (int b = num_bodies - 1; b > 0; --b) {
            if (parent[b] == 0)
                continue;
            const V* from = (const V*)&composite[b];
            V* to = (V*)&composite[parent[b]];
            for (int k = 0; k < 10; ++k)
                to[k] += from[k];
        }
    }

    // Motions of the degrees of freedom, velocities, and their change with the bodies' own motion.
    template <class State> __attribute__((always_inline)) void find_motions(State& qvel) {
        speed = block.in(qvel);
        dof = block.template out<Motion<V>>(motion.cdof);
        dof_change = block.template out<Motion<V>>(motion.cdof_dot);
        velocity = block.template out<Motion<V>>(motion.cvel);
        acceleration = block.template out<Motion<V>>(motion.cacc);
        velocity[0] = acceleration[0] = {origin, origin};
        if (switches.has_gravity)
            acceleration[0].linear = origin - block.model(bodies.gravity).vec3(0);
        for (int b = 1; b < num_bodies; ++b) {
            Motion<V> v = velocity[parent[b]], a = acceleration[parent[b]];
            const int begin = bodies.body_jntadr.data[b], end = begin + bodies.body_jntnum.data[b];
            for (int j = begin; j < end; ++j) {
                const Vec3<V> arm = com[root[b]] - anchor[j];
                int i = first_dof[j];
                if (joint_kind[j] == HINGE) {
                    dof[i] = {axis[j], cross(axis[j], arm)};
                } else if (joint_kind[j] == SLIDE) {
                    dof[i] = {origin, axis[j]};
                } else {
                    if (joint_kind[j] == FREE) {  // its translation comes first, along the world's axes
                        for (int k = 0; k < 3; ++k, ++i) {
                            dof[i] = dof_change[i] = {origin, origin};
                            (&dof[i].linear.x)[k] = one;
                            add(v, dof[i], speed[i]);
                        }
                    }
                    for (int k = 0; k < 3; ++k) {
                        const Vec3<V> column = {frame[b].m[0][k], frame[b].m[1][k], frame[b].m[2][k]};
                        dof[i + k] = {column, cross(column, arm)};
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
    }

    // M_ij = dof_i' (composite inertia of i's body) dof_j, for i and the dofs that carry it.
    __attribute__((always_inline)) void find_mass_matrix() {
        const Field<V> armature = block.model(bodies.dof_armature);
        M = block.template out<V>(motion.M);
        for (int i = 0; i < num_dofs; ++i) {
            const Motion<V> momentum = times(composite[bodies.dof_bodyid.data[i]], dof[i]);
            const int begin = bodies.M_rowadr.data[i];
            int entry = begin + bodies.M_rownnz.data[i] - 1;
            M[entry] = armature[i] + dot(dof[i], momentum);
            const int* carrier = bodies.dof_parentid.data;
            for (int j = carrier[i]; j >= 0 && entry > begin; j = carrier[j])
                M[--entry] = dot(dof[j], momentum);
        }
    }

    // Bias: what the bodies' accelerations without any qacc take, summed over subtrees.
    __attribute__((always_inline)) void find_bias() {
        force = block.template out<Motion<V>>(motion.cfrc_int);
        bias = block.template out<V>(motion.qfrc_bias);
        force[0] = {origin, origin};
        for (int b = 1; b < num_bodies; ++b) {
            force[b] = times(inertia[b], acceleration[b]);
            add(force[b], cross_force(velocity[b], times(inertia[b], velocity[b])), one);
        }
        for (int b = num_bodies - 1; b > 0; --b)
            add(force[parent[b]], force[b], one);
        for (int i = 0; i < num_dofs; ++i)
            bias[i] = dot(dof[i], force[bodies.dof_bodyid.data[i]]);
    }

    // Springs and dampers of joints, whose coefficients may grow with the deflection and the speed.
    __attribute__((always_inline)) void find_passive_forces() {
        const Field<V> rest = block.model(bodies.qpos_spring);
        const Field<V> stiffness = block.model(bodies.jnt_stiffness);
        const Field<V> damping = block.model(bodies.dof_damping);
        const Field<V> more_stiffness = block.model(bodies.jnt_stiffnesspoly);
        const Field<V> more_damping = block.model(bodies.dof_dampingpoly);
        spring = block.template out<V>(motion.qfrc_spring);
        damper = block.template out<V>(motion.qfrc_damper);
        passive = block.template out<V>(motion.qfrc_passive);
        auto coefficient = [](V linear, const Field<V>& more, int i, V x) {
            return linear + more[2 * i] * x + more[2 * i + 1] * x * x;
        };
        for (int j = 0; j < num_joints; ++j) {
            const int begin = first_dof[j], end = begin + dofs_of(joint_kind[j]);
            for (int i = begin; i < end; ++i) {
                spring[i] = zero;
                const V drag = coefficient(damping[i], more_damping, i, absolute(speed[i]));
                damper[i] = switches.has_dampers ? -speed[i] * drag : zero;
            }
            if (switches.has_springs && joint_kind[j] >= SLIDE) {
                const V x = angle[bodies.jnt_qposadr.data[j]] - rest[bodies.jnt_qposadr.data[j]];
                spring[begin] = -x * coefficient(stiffness[j], more_stiffness, j, x);
            }
            for (int i = begin; i < end; ++i)
                passive[i] = spring[i] + damper[i];
        }
    }

    __attribute__((always_inline)) void store_pose() {
        store(pose.xpos, position, last || touches);
        store(pose.xquat, orientation, last);
        store(pose.xmat, frame, last || touches);
        store(pose.xanchor, anchor, last);
        store(pose.xaxis, axis, last);
    }

    __attribute__((always_inline)) void store_motion() {
        store(pose.xipos, center, last);
        store(pose.ximat, principal, last);
        store(motion.subtree_com, com, last || touches);
        store(motion.cinert, inertia, last);
        store(motion.crb, composite, last);
        store(motion.cdof, dof, last || touches);
        store(motion.cdof_dot, dof_change, last);
        store(motion.cvel, velocity, last || touches);
        store(motion.cacc, acceleration, last);
        store(motion.cfrc_int, force, last);
        store(motion.M, M);
        store(motion.qfrc_bias, bias);
        store(motion.qfrc_spring, spring, last);
        store(motion.qfrc_damper, damper, last);
        store(motion.qfrc_passive, passive);
    }
};

template <class V, class Bodies, class Switches, class Sites, class State, class Pose, class Moving>
void move_block(Block<V>& block, Bodies& bodies, Switches& switches, Sites& sites, State& qpos, State& qvel,
                Pose& pose, Moving& motion) {
    Mover<V, Bodies, Switches, Pose, Moving> mover{block, bodies, switches, pose, motion};
    mover.pose_bodies(qpos);
    mover.place_sites(sites);
    mover.store_pose();
    if (!switches.dynamics)
        return;
    mover.place_masses();
    mover.place_geoms();
    mover.find_inertias();
    mover.find_motions(qvel);
    mover.find_mass_matrix();
    mover.find_bias();
    mover.find_passive_forces();
    mover.store_motion();
}
}  // namespace lanes
