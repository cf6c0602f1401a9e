// Body of the native function `solve_motion` (integrate.py, which explains the method); AFFINE and the sizes
// are defined before it. Rows of M hold the dofs above their own and end with it, so that the beginning of a row
// is the row of the dof where it stops.

auto row = [&](const auto& array) {
    return decltype(array.data)((char*)array.data + world % array.shape[0] * array.strides[0]);
};
const int n = Ma.shape[0], num_entries = M.shape[0];
const int *begins = inertia.M_rowadr.data, *sizes = inertia.M_rownnz.data, *columns = inertia.M_colind.data;

// The derivative of forces by velocity, in the pattern of M; then M minus h times it; then its factor.
// H[-1] takes what has no place in M, whose number is -1.
float storage[MAX_ENTRIES + 1], x[MAX_DOFS], inverse_pivot[MAX_DOFS];
float* H = storage + 1;
for (int k = 0; k < num_entries; ++k)
    H[k] = 0.0f;

if (implicit_actuators) {
    const auto* biasprm = row(forces.actuator_biasprm);
    const auto* forcerange = row(forces.actuator_forcerange);
    const float *force = row(forces.actuator_force), *moments = row(forces.actuator_moment);
    const int *first = row(forces.moment_rowadr), *count = row(forces.moment_rownnz);
    const int* dofs = row(forces.moment_colind);
    for (int a = 0; a < forces.actuator_biasprm.shape[1]; ++a) {
        const float slope = forces.actuator_biastype.data[a] == AFFINE ? biasprm[a][2] : 0.0f;
        if (slope == 0.0f)
            continue;
        if (forces.actuator_forcelimited.data[a])
            if (force[a] <= forcerange[a][0] || force[a] >= forcerange[a][1])
                continue;
        for (int i = first[a]; i < first[a] + count[a]; ++i) {
            const float pull = moments[i] * slope;
            const int* entries = forces.M_elemid.data + dofs[i] * n;
            for (int j = first[a]; j <= i; ++j)
                H[entries[dofs[j]]] += pull * moments[j];
        }
    }
}

const float* damping = row(forces.dof_damping);
const auto* polynomial = row(forces.dof_dampingpoly);
for (int i = 0; i < n; ++i) {
    const float speed = wp::abs(qvel[i]);
    const float slope = damping[i] + speed * (2.0f * polynomial[i][0] + 3.0f * speed * polynomial[i][1]);
    H[begins[i] + sizes[i] - 1] -= slope;
}

// The engine solves free bodies once more by itself, and falls back on the plain M.
if (implicit_actuators)
    for (int i = 0; i < forces.body_freeadr.shape[0]; ++i) {
        const int dof = forces.body_dofadr.data[forces.body_freeadr.data[i]];
        for (int k = begins[dof]; k < begins[dof + 5] + sizes[dof + 5]; ++k)
            H[k] = 0.0f;
    }

for (int k = 0; k < num_entries; ++k)
    H[k] = M[k] - timestep * H[k];
for (int i = 0; i < n; ++i)
    x[i] = Ma[i];

// H = L' D L from the tips on, and x = L'^-1 Ma on the way.
for (int i = n - 1; i >= 0; --i) {
    float* tip = H + begins[i];
    const int* above = columns + begins[i];
    const int last = sizes[i] - 1;
    const float inverse = inverse_pivot[i] = 1.0f / tip[last];
    for (int k = last - 1; k >= 0; --k) {
        const float ratio = tip[k] * inverse;
        float* carrier = H + begins[above[k]];
        for (int j = 0; j <= k; ++j)
            carrier[j] -= ratio * tip[j];
        tip[k] = ratio;
        x[above[k]] -= ratio * x[i];
    }
}
for (int i = 0; i < n; ++i) {
    const float* tip = H + begins[i];
    const int* above = columns + begins[i];
    float value = x[i] * inverse_pivot[i];
    for (int k = 0; k < sizes[i] - 1; ++k)
        value -= tip[k] * x[above[k]];
    acceleration[i] = x[i] = value;
}
