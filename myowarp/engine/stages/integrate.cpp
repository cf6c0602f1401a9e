// The end of a physics step of the worlds of a block (integrate.py explains the method, lanes.cpp what V is).
#if MYOWARP_LANES == 1
#warning MyoWarp: the compiler has no vectors of floats; worlds go one after the other, which is slower
#endif
namespace lanes {

// The derivative of the actuators' forces by velocity, in the pattern of M. H[-1] takes what has no place in
// it, whose number is -1. In every world an actuator acts on the same dofs.
template <class V, class Forces> void add_actuators(Block<V>& block, Forces& forces, int n, V* H) {
    const Field<V> bias = block.model(forces.actuator_biasprm);
    const Field<V> range = block.model(forces.actuator_forcerange);
    const V *force = block.in(forces.actuator_force), *moments = block.in(forces.actuator_moment);
    const int* first = ints_of(forces.moment_rowadr, block.first);
    const int* count = ints_of(forces.moment_rownnz, block.first);
    const int* dofs = ints_of(forces.moment_colind, block.first);
    for (int a = 0; a < forces.actuator_biasprm.shape[1]; ++a) {
        if (forces.actuator_biastype.data[a] != AFFINE)
            continue;
        V slope = bias[10 * a + 2];
        if (forces.actuator_forcelimited.data[a])
            slope = select((force[a] > range[2 * a]) & (force[a] < range[2 * a + 1]), slope, splat<V>(0.0f));
        for (int i = first[a]; i < first[a] + count[a]; ++i) {
            if (!any(moments[i] != 0.0f))
                continue;
            const V pull = moments[i] * slope;
            const int* entries = forces.M_elemid.data + dofs[i] * n;
            for (int j = first[a]; j <= i; ++j)
                H[entries[dofs[j]]] += pull * moments[j];
        }
    }
}

// x = (M - h dF/dv)^-1 Ma.
template <class V, class Parts, class Inertia, class Forces, class State>
void accelerate(Block<V>& block, Parts& parts, Inertia& inertia, Forces& forces, State& M, State& Ma,
                const V* speed, V timestep, V* x) {
    const int n = forces.dof_damping.shape[1], num_entries = M.shape[1];
    const int *begins = inertia.M_rowadr.data, *sizes = inertia.M_rownnz.data;
    V *H = block.take(num_entries + 1) + 1, *inverse_pivot = block.take(n);
    for (int k = 0; k < num_entries; ++k)
        H[k] = splat<V>(0.0f);
    if (parts.implicit_actuators)
        add_actuators(block, forces, n, H);
    const Field<V> damping = block.model(forces.dof_damping), more = block.model(forces.dof_dampingpoly);
    for (int i = 0; i < n; ++i) {
        const V pace = absolute(speed[i]);
        const V slope = 2.0f * more[2 * i] + 3.0f * pace * more[2 * i + 1];
        H[begins[i] + sizes[i] - 1] -= damping[i] + pace * slope;
    }
    // The engine solves free bodies once more by itself, and falls back on the plain M.
    if (parts.implicit_actuators)
        for (int i = 0; i < forces.body_freeadr.shape[0]; ++i) {
            const int dof = forces.body_dofadr.data[forces.body_freeadr.data[i]];
            for (int k = begins[dof]; k < begins[dof + 5] + sizes[dof + 5]; ++k)
                H[k] = splat<V>(0.0f);
        }
    const V *inertias = block.in(M), *momentum = block.in(Ma);
    for (int k = 0; k < num_entries; ++k)
        H[k] = inertias[k] - timestep * H[k];
    for (int i = 0; i < n; ++i)
        x[i] = momentum[i];
    factorize(inertia, n, H, inverse_pivot);
    substitute(inertia, n, H, inverse_pivot, x);
}

// quat = quat exp(h w / 2).
template <class V> INLINE void turn(const V* quat, const V* w, V timestep, V* to) {
    const Vec3<V> axis = {w[0], w[1], w[2]};
    const V square = dot(axis, axis), speed = root(square);
    V sine, cosine;
    sine_cosine(0.5f * timestep * speed, sine, cosine);
    const V scale = select(square > 0.0f, sine / speed, splat<V>(0.0f));
    const Quat<V> before = normalized(Quat<V>{quat[0], quat[1], quat[2], quat[3]});
    const Vec3<V> part = scale * axis;
    *(Quat<V>*)to = normalized(multiply(before, Quat<V>{cosine, part.x, part.y, part.z}));
}

template <class V, class Parts, class Inertia, class Joints, class Row, class Forces, class Usage,
          class State>
void end_block(Block<V>& block, Parts& parts, Inertia& inertia, Joints& joints, Row& M, Row& Ma, Row& qacc,
               Forces& forces, Usage& usage, Row& acceleration, State& state) {
    const int n = state.qvel.shape[1];
    const V timestep = block.model(parts.timestep)[0];
    const V *speed = block.in(state.qvel), *change = nullptr;
    if (parts.solve) {
        V* x = block.template out<V>(acceleration);
        accelerate(block, parts, inertia, forces, M, Ma, speed, timestep, x);
        block.store(acceleration, x, 0, n);
        change = x;
    } else {
        change = block.in(acceleration);
    }
    if (!parts.advance)
        return;
    V* velocity = block.template out<V>(state.qvel);
    for (int i = 0; i < n; ++i)
        velocity[i] = speed[i] + timestep * change[i];
    const V *before = block.in(state.qpos), *now = block.in(state.time);
    V *after = block.template out<V>(state.qpos), *time = block.template out<V>(state.time);
    for (int joint = 0; joint < joints.jnt_type.shape[0]; ++joint) {
        const int kind = joints.jnt_type.data[joint], scalars = kind == FREE ? 3 : kind == BALL ? 0 : 1;
        const int at = joints.jnt_qposadr.data[joint], dof = joints.jnt_dofadr.data[joint];
        for (int i = 0; i < scalars; ++i)
            after[at + i] = before[at + i] + timestep * velocity[dof + i];
        if (kind == FREE || kind == BALL)
            turn(before + at + scalars, velocity + dof + scalars, timestep, after + at + scalars);
    }
    time[0] = now[0] + timestep;
    block.store(state.qvel, velocity, 0, n);
    block.store(state.qpos, after, 0, state.qpos.shape[1]);
    block.store(state.time, time, 0, 1);
    for (int world = block.first; world < block.first + block.count; ++world) {
        memcpy(row_of(state.qacc_warmstart, world), row_of(qacc, world), n * sizeof(float));
        int& overflow = state.overflow.data[world];
        overflow |= usage.nefc.data[world] > usage.njmax ? NEFC_OVERFLOW : 0;
        overflow |= usage.ncollision.data[0] > usage.naconmax ? BROADPHASE_OVERFLOW : 0;
        overflow |= usage.nacon.data[0] > usage.naconmax ? NARROWPHASE_OVERFLOW : 0;
    }
}
}  // namespace lanes
