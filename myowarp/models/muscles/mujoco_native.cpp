// The muscles of the worlds of a block: the law of mujoco.py, free of branches (lanes.cpp says what V is).
namespace lanes {

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
    Pulling<V, Anatomy, Results, Bias> pulling(block, anatomy, results, actuator_biasprm, actuator_length,
                                               actuator_velocity);
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
    const V *control = block.in(ctrl), *before = block.in(activation);
    V* after = block.template out<V>(activation);

    for (int m = 0; m < num_muscles; ++m) {
        const V excitation = clamp(control[params.actuator_id.data[m]], bounds[2 * m], bounds[2 * m + 1]);
        pulling.fetch(m);
        const V length = pulling.length[m], velocity = pulling.velocity[m], start = before[m];
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
        const V isometric = now * pulling.strength[m] * peak[m] * fl;
        const V pull = pulling.transmission[m] * (isometric * fv + passive_peak[m] * fp);
        // Explicit integrators have no use for the slope, and force - kv v + kv v would only round.
        const V drag =
            implicitness > 0.0f ? implicitness * pulling.transmission[m] * (isometric * slope / v0) : zero;
        after[m] = end;
        if (pulling.works)
            pulling.work[m] = pulling.worked[m] + dt * (now * fl * fv);
        pulling.publish(m, pull, drag);
    }
    block.store(activation, after, 0, num_muscles);
    pulling.store(num_muscles);
}
}  // namespace lanes
