// Body of the native function `contract` (mujoco_native.py). The law is mujoco.py's, free of branches, so that
// loops over muscles become SIMD.

auto activation_rate = [](float excitation, float activation, float tau_act, float tau_deact, float width) {
    const float scale = 0.5f + 1.5f * wp::min(wp::max(activation, 0.0f), 1.0f);
    const float rise = tau_act * scale, fall = tau_deact / scale, difference = excitation - activation;
    const float x = wp::min(wp::max(difference / wp::max(width, 1e-15f) + 0.5f, 0.0f), 1.0f);
    const float hard = difference > 0.0f ? rise : fall;
    const float smooth = fall + (rise - fall) * (x * x * x * (x * (6.0f * x - 15.0f) + 10.0f));
    const float time_constant = width < 1e-15f ? hard : smooth;
    return difference / wp::max(time_constant, 1e-15f);
};

// What is left of `start` after `duration`: c ln(part / start) - (part - start) = -duration, by two steps of
// Halley's method from the rate half way on. They leave 4e-9 after a duration of 2.
auto part_left = [&](float duration, float c, float start) {
    const float half = 0.5f * duration / (c - start);
    float x = -duration / (c - start / (1.0f + half + 0.5f * half * half)), part = 0.0f, step = 0.0f;
    for (int i = 0; i < 2; ++i) {
        part = start * decay(x);
        const float slope = c - part, excess = c * x - part + start + duration;
        step = -excess * slope / (slope * slope + 0.5f * excess * part);
        x += step;
    }
    return part * (1.0f + step + 0.5f * step * step);
};

auto activation_after = [&](float time, float excitation, float activation, float tau_act, float tau_deact) {
    const float c = 0.5f + 1.5f * excitation, gap = excitation - activation;
    const float left = part_left(time / wp::max(tau_act, 1e-15f), c, 1.5f * wp::max(gap, 0.0f));
    const float w = -gap / (c - 1.5f * gap) * decay(-c * time / wp::max(tau_deact, 1e-15f));
    return excitation + (gap > 0.0f ? -left * (1.0f / 1.5f) : c * w / (1.0f - 1.5f * w));
};

auto quadratic_force_length = [](float length, float lmin, float lmax) {
    const float x = wp::abs(1.0f - length) / (length < 1.0f ? 1.0f - lmin : lmax - 1.0f);
    const float rest = wp::max(1.0f - x, 0.0f);
    return x < 0.5f ? 1.0f - 2.0f * x * x : 2.0f * rest * rest;
};
auto quadratic_force_velocity = [](float velocity, float fvmax) {
    const float saturation = fvmax - 1.0f, rise = wp::max(velocity + 1.0f, 0.0f);
    const float rest = wp::max(saturation - velocity, 0.0f);
    return velocity <= 0.0f ? rise * rise : fvmax - rest * (rest / wp::max(saturation, 1e-15f));
};
auto quadratic_force_velocity_slope = [](float velocity, float fvmax) {
    const float saturation = fvmax - 1.0f, rise = wp::max(velocity + 1.0f, 0.0f);
    const float rest = wp::max(saturation - velocity, 0.0f);
    return 2.0f * (velocity <= 0.0f ? rise : rest / wp::max(saturation, 1e-15f));
};
auto quadratic_passive_force = [](float length, float lmax, float fpmax) {
    const float x = 2.0f * wp::max(length - 1.0f, 0.0f) / wp::max(lmax - 1.0f, 1e-15f);
    return fpmax * (x <= 1.0f ? 0.5f * x * x : x - 0.5f);
};

// Muscles go in groups, as many as a SIMD register has lanes: a third of the time that one after the other
// takes. On CUDA every muscle has a thread of its own.

constexpr int LANES = 8;
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
float* tension_to = &wp::index(results.tension, world, 0);
float* length_to = &wp::index(results.length, world, 0);
float* velocity_to = &wp::index(results.velocity, world, 0);
float* damping_to = &wp::index(results.damping, world, 0);
float* work = results.workload.shape[0] > 0 ? &wp::index(results.workload, world, 0) : nullptr;

for (int first = 0; first < num_muscles; first += LANES) {
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

    Lanes now = before, after, pull, force, slope, power;
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
        // Explicit integrators have no use for the slope, and force - kv v + kv v would only round.
        const float dforce = isometric * quadratic_force_velocity_slope(v, fvmax[k]) / v0;
        slope[k] = implicitness > 0.0f ? implicitness * transmission[k] * dforce : 0.0f;
        pull[k] = transmission[k] * (isometric * fv + passive_peak[k] * fp);
        force[k] = slope[k] * velocity[k] - pull[k];
        power[k] = now[k] * fl * fv;
    }

    for (int k = 0; k < LANES && first + k < num_muscles; ++k) {
        const int m = first + k;
        a[m] = after[k];
        auto& affine = bias[path[m]];
        affine = {};
        affine[0] = force[k];
        affine[2] = -slope[k];
        tension_to[m] = pull[k];
        length_to[m] = length[k];
        velocity_to[m] = velocity[k];
        damping_to[m] = slope[k];
        if (work)
            work[m] += dt * power[k];
    }
}
