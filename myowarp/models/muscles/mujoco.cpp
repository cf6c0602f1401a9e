// Body of the native function `contract` (mujoco.py, which explains it), after curves.cpp and activation.cpp.
// Muscles go in groups, as many as a SIMD register has lanes: a third of the time that one after the other
// takes. On CUDA every muscle has a thread of its own.

#if defined(__CUDA_ARCH__)
constexpr int LANES = 1;
#else
constexpr int LANES = 8;
#endif
struct Lanes {
    float lane[LANES];
    CUDA_CALLABLE float& operator[](int k) { return lane[k]; }
    CUDA_CALLABLE float operator[](int k) const { return lane[k]; }
};
const int num_muscles = activation.shape[1];
// A world's row of an array that has one for all worlds or one for each.
auto row = [&](auto& rows) { return &wp::index(rows, rows.shape[0] > 1 ? world : 0, 0); };
const auto* bounds = row(params.excitation_range);
const int* path = row(anatomy.path);
const float* control = &wp::index(ctrl, world, 0);
const float* length_of = &wp::index(actuator_length, world, 0);
const float* velocity_of = &wp::index(actuator_velocity, world, 0);
float* a = &wp::index(activation, world, 0);
auto* bias = row(actuator_biasprm);
float* work = workload.shape[0] > 0 ? &wp::index(workload, world, 0) : nullptr;

for (int first = thread * LANES; first < num_muscles; first += threads * LANES) {
    auto muscle = [&](int k) { return wp::min(first + k, num_muscles - 1); };  // the last one fills up
    const bool whole = first + LANES <= num_muscles;
    auto load = [&](const float* from) {
        Lanes to;
        if (whole) {  // in one move
            for (int k = 0; k < LANES; ++k)
                to[k] = from[first + k];
        } else {
            for (int k = 0; k < LANES; ++k)
                to[k] = from[muscle(k)];
        }
        return to;
    };
    const Lanes tau_act = load(row(params.activation_time_constant));
    const Lanes tau_deact = load(row(params.deactivation_time_constant));
    const Lanes width = load(row(params.smoothing_width));
    const Lanes peak = load(row(params.max_isometric_force));
    const Lanes strength = load(row(anatomy.strength));
    const Lanes l0 = load(row(params.optimal_fiber_length));
    const Lanes slack = load(row(params.tendon_slack_length));
    const Lanes lmin = load(row(params.min_norm_length));
    const Lanes lmax = load(row(params.max_norm_length));
    const Lanes vmax = load(row(params.max_contraction_velocity));
    const Lanes fvmax = load(row(params.eccentric_multiplier));
    const Lanes passive_peak = load(row(params.passive_peak_force));
    const Lanes passive_l0 = load(row(params.passive_optimal_length));
    const Lanes passive_slack = load(row(params.passive_slack_length));
    const Lanes passive_lmax = load(row(params.passive_max_norm_length));
    const Lanes fpmax = load(row(params.passive_multiplier));
    const Lanes transmission = load(row(anatomy.transmission));
    Lanes excitation, before, length, velocity;
    for (int k = 0; k < LANES; ++k) {
        const int m = muscle(k);
        excitation[k] = wp::min(wp::max(control[params.actuator_id.data[m]], bounds[m][0]), bounds[m][1]);
        before[k] = a[m];
        length[k] = length_of[path[m]];
        velocity[k] = velocity_of[path[m]];
    }

    Lanes now = before, after, force, damping, power;
    bool exact = midstep;
    for (int k = 0; k < LANES; ++k)
        exact = exact && width[k] == 0.0f;
    if (!exact) {
        for (int k = 0; k < LANES; ++k)
            after[k] = before[k]
                + dt * activation_rate(excitation[k], before[k], tau_act[k], tau_deact[k], width[k]);
    }
    if (midstep) {
        for (int k = 0; k < LANES; ++k) {
            const float u = excitation[k], u0 = before[k];
            const float half = activation_after(0.5f * dt, u, u0, tau_act[k], tau_deact[k]);
            const float full = activation_after(dt, u, u0, tau_act[k], tau_deact[k]);
            now[k] = width[k] == 0.0f ? half : now[k];  // a smooth switch has no closed form
            after[k] = width[k] == 0.0f ? full : after[k];
        }
    }
    for (int k = 0; k < LANES; ++k) {
        const float v0 = l0[k] * vmax[k], v = velocity[k] / v0;
        const float fl = quadratic_force_length((length[k] - slack[k]) / l0[k], lmin[k], lmax[k]);
        const float fv = quadratic_force_velocity(v, fvmax[k]);
        const float passive_length = (length[k] - passive_slack[k]) / passive_l0[k];
        const float fp = quadratic_passive_force(passive_length, passive_lmax[k], fpmax[k]);
        const float isometric = now[k] * strength[k] * peak[k] * fl;
        const float slope = -isometric * quadratic_force_velocity_slope(v, fvmax[k]) / v0;
        // Explicit integrators have no use for the slope, and force - kv v + kv v would only round.
        damping[k] = implicitness > 0.0f ? implicitness * transmission[k] * slope : 0.0f;
        force[k] = -transmission[k] * (isometric * fv + passive_peak[k] * fp) - damping[k] * velocity[k];
        power[k] = now[k] * fl * fv;
    }

    for (int k = 0; k < LANES && first + k < num_muscles; ++k) {
        const int m = first + k;
        a[m] = after[k];
        auto& affine = bias[path[m]];
        affine = {};
        affine[0] = force[k];
        affine[2] = damping[k];
        if (work)
            work[m] += dt * power[k];
    }
}
