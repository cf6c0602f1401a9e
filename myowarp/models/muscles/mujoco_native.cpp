// The muscles of the worlds of a block: the law of mujoco.py, free of branches (lanes.cpp says what V is).
namespace lanes {

template <class V> INLINE V at_least(float least, V x) { return larger(splat<V>(least), x); }
template <class V> INLINE V clamp(V x, V low, V high) { return smaller(larger(x, low), high); }

template <class V>
INLINE V activation_rate(V excitation, V activation, V tau_act, V tau_deact, V width) {
    const V one = splat<V>(1.0f), zero = splat<V>(0.0f);
    const V scale = 0.5f + 1.5f * clamp(activation, zero, one);
    const V rise = tau_act * scale, fall = tau_deact / scale, difference = excitation - activation;
    const V x = clamp(difference / at_least(TINY, width) + 0.5f, zero, one);
    const V hard = select(difference > 0.0f, rise, fall);
    const V smooth = fall + (rise - fall) * (x * x * x * (x * (6.0f * x - 15.0f) + 10.0f));
    return difference / at_least(TINY, select(width < TINY, hard, smooth));
}

// What is left of `start` after `duration`: c ln(part / start) - (part - start) = -duration, by two steps of
// Halley's method from the rate half way on. They leave 4e-9 after a duration of 2.
template <class V> INLINE V part_left(V duration, V c, V start) {
    const V half = 0.5f * duration / (c - start);
    V x = -duration / (c - start / (1.0f + half + 0.5f * half * half)), part, step;
    for (int i = 0; i < 2; ++i) {
        part = start * decay(x);
        const V slope = c - part, excess = c * x - part + start + duration;
        step = -excess * slope / (slope * slope + 0.5f * excess * part);
        x += step;
    }
    return part * (1.0f + step + 0.5f * step * step);
}

template <class V> INLINE V activation_after(V time, V excitation, V activation, V tau_act, V tau_deact) {
    const V c = 0.5f + 1.5f * excitation, gap = excitation - activation;
    const auto rises = gap > 0.0f;
    V change = gap;
    if (any(rises))
        change = part_left(time / at_least(TINY, tau_act), c, 1.5f * at_least(0.0f, gap)) * (-1.0f / 1.5f);
    if (any(opposite(rises))) {
        const V w = -gap / (c - 1.5f * gap) * decay(-c * time / at_least(TINY, tau_deact));
        change = select(rises, change, c * w / (1.0f - 1.5f * w));
    }
    return excitation + change;
}

template <class V> INLINE V quadratic_force_length(V length, V lmin, V lmax) {
    const V x = absolute(1.0f - length) / select(length < 1.0f, 1.0f - lmin, lmax - 1.0f);
    const V rest = at_least(0.0f, 1.0f - x);
    return select(x < 0.5f, 1.0f - 2.0f * x * x, 2.0f * rest * rest);
}

// f_V and its slope.
template <class V> INLINE V quadratic_force_velocity(V velocity, V fvmax, V& slope) {
    const V saturation = fvmax - 1.0f, rise = at_least(0.0f, velocity + 1.0f);
    const V rest = at_least(0.0f, saturation - velocity), share = rest / at_least(TINY, saturation);
    const auto shortens = velocity <= 0.0f;
    slope = 2.0f * select(shortens, rise, share);
    return select(shortens, rise * rise, fvmax - rest * share);
}

template <class V> INLINE V quadratic_passive_force(V length, V lmax, V fpmax) {
    const V x = 2.0f * at_least(0.0f, length - 1.0f) / at_least(TINY, lmax - 1.0f);
    return fpmax * select(x <= 1.0f, 0.5f * x * x, x - 0.5f);
}

template <class V, class Params, class Anatomy, class Times, class Row, class Results, class Bias>
void contract_block(Block<V>& block, Params& params, Anatomy& anatomy, Times& timestep, bool midstep,
                    float implicitness, Row& ctrl, Row& actuator_length, Row& actuator_velocity,
                    Row& activation, Results& results, Bias& actuator_biasprm) {
    const int num_muscles = activation.shape[1];
    constexpr int width_of_block = sizeof(V) / sizeof(float);
    const bool own_paths = anatomy.path.shape[0] > 1;
    const int* paths[width_of_block];  // a muscle may pull another one in each world
    for (int lane = 0; lane < width_of_block; ++lane) {
        const int world = block.first + (lane < block.count ? lane : block.count - 1);
        paths[lane] = ints_of(anatomy.path, world % anatomy.path.shape[0]);
    }
    auto pulled = [&](const V* values, int m) {
        V found = values[paths[0][m]];
        for (int lane = 1; own_paths && lane < width_of_block; ++lane)
            ((float*)&found)[lane] = ((const float*)&values[paths[lane][m]])[lane];
        return found;
    };
    const V dt = block.model(timestep)[0], zero = splat<V>(0.0f);
    const Field<V> bounds = block.model(params.excitation_range);
    const Field<V> tau_act = block.model(params.activation_time_constant);
    const Field<V> tau_deact = block.model(params.deactivation_time_constant);
    const Field<V> width = block.model(params.smoothing_width);
    const Field<V> peak = block.model(params.max_isometric_force);
    const Field<V> l0 = block.model(params.optimal_fiber_length);
    const Field<V> slack = block.model(params.tendon_slack_length);
    const Field<V> lmin = block.model(params.min_norm_length), lmax = block.model(params.max_norm_length);
    const Field<V> vmax = block.model(params.max_contraction_velocity);
    const Field<V> fvmax = block.model(params.eccentric_multiplier);
    const Field<V> passive_peak = block.model(params.passive_peak_force);
    const Field<V> passive_l0 = block.model(params.passive_optimal_length);
    const Field<V> passive_slack = block.model(params.passive_slack_length);
    const Field<V> passive_lmax = block.model(params.passive_max_norm_length);
    const Field<V> fpmax = block.model(params.passive_multiplier);
    const Field<V> strength = block.model(anatomy.strength), transmission = block.model(anatomy.transmission);
    const V *control = block.in(ctrl), *lengths = block.in(actuator_length), *before = block.in(activation);
    const V* velocities = block.in(actuator_velocity);
    const bool works = results.workload.shape[0] > 0;
    const V* worked = works ? block.in(results.workload) : nullptr;
    V* work = works ? block.template out<V>(results.workload) : nullptr;
    V* after = block.template out<V>(activation);
    V *tension = block.template out<V>(results.tension), *damping = block.template out<V>(results.damping);
    V* length_to = block.template out<V>(results.length);
    V* velocity_to = block.template out<V>(results.velocity);

    for (int m = 0; m < num_muscles; ++m) {
        const V excitation = clamp(control[params.actuator_id.data[m]], bounds[2 * m], bounds[2 * m + 1]);
        const V length = pulled(lengths, m), velocity = pulled(velocities, m), start = before[m];
        V now = start, end = start;
        const auto exact = width[m] == 0.0f, smooth = opposite(exact);  // which has no closed form
        if (!midstep || any(smooth))
            end = start + dt * activation_rate(excitation, start, tau_act[m], tau_deact[m], width[m]);
        if (midstep && any(exact)) {
            const V middle = activation_after(0.5f * dt, excitation, start, tau_act[m], tau_deact[m]);
            now = select(exact, middle, now);
            end = select(exact, activation_after(dt, excitation, start, tau_act[m], tau_deact[m]), end);
        }
        const V v0 = l0[m] * vmax[m];
        V slope;
        const V fl = quadratic_force_length((length - slack[m]) / l0[m], lmin[m], lmax[m]);
        const V fv = quadratic_force_velocity(velocity / v0, fvmax[m], slope);
        const V passive_length = (length - passive_slack[m]) / passive_l0[m];
        const V fp = quadratic_passive_force(passive_length, passive_lmax[m], fpmax[m]);
        const V isometric = now * strength[m] * peak[m] * fl;
        const V pull = transmission[m] * (isometric * fv + passive_peak[m] * fp);
        // Explicit integrators have no use for the slope, and force - kv v + kv v would only round.
        const V drag = implicitness > 0.0f ? implicitness * transmission[m] * (isometric * slope / v0) : zero;
        after[m] = end;
        tension[m] = pull;
        damping[m] = drag;
        length_to[m] = length;
        velocity_to[m] = velocity;
        if (works)
            work[m] = worked[m] + dt * (now * fl * fv);
        const V constant = drag * velocity - pull, factor = -drag;
        for (int lane = 0; lane < block.count; ++lane) {
            float* affine = row_of(actuator_biasprm, block.first + lane) + 10 * paths[lane][m];
            memset(affine, 0, 10 * sizeof(float));
            affine[0] = ((const float*)&constant)[lane];
            affine[2] = ((const float*)&factor)[lane];
        }
    }
    block.store(activation, after, 0, num_muscles);
    block.store(results.tension, tension, 0, num_muscles);
    block.store(results.damping, damping, 0, num_muscles);
    block.store(results.length, length_to, 0, num_muscles);
    block.store(results.velocity, velocity_to, 0, num_muscles);
    if (works)
        block.store(results.workload, work, 0, num_muscles);
}
}  // namespace lanes
