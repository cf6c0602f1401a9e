// The Hill muscles of the worlds of a block: the laws of hill_law.py, free of branches (lanes.cpp says what V
// is). Names in capitals are places of `hill_muscle` and the laws' numbers.
namespace lanes {

template <class V> struct Curve { V value, slope; };

// Parameters of a muscle in the worlds of a block.
template <class V> struct Muscle {
    const Field<V>& rows;
    int begin;
    V operator[](int name) const { return rows[begin + name]; }
};

template <class V> INLINE Curve<V> growth(V x) {
    const V value = decay(smaller(x, splat<V>(25.0f)));
    return {value * (1.0f + at_least(0.0f, x - 25.0f)), value};
}

// ln x for normal x > 0, to 1e-7: Moshier, Cephes, logf.
template <class V> INLINE V logarithm(V x) {
    const auto n = bits(x);
    V e = number((n >> 23) - 126), m = from_bits((n & 0x7fffff) | 0x3f000000);
    const auto low = m < 0.707106781f;
    e = select(low, e - 1.0f, e);
    m = select(low, m + m, m) - 1.0f;
    V p = 7.0376836292e-2f * m - 1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m - 1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m - 1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m - 2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    const V z = m * m;
    return m + (p * m * z - 2.12194440e-4f * e - 0.5f * z) + 0.693359375f * e;
}

// A curve of `tabulated`.
template <class V> struct Table {
    V first, density;
    typename IntsOf<V>::type begin;
    const float* values;
    int knots;

    template <class Tables> Table(Tables& tables, V curves, int which) {
        values = (const float*)tables.values.data;
        knots = tables.values.shape[1];
        const auto curve = bits(curves) + which;
        begin = 2 * knots * curve;
        const int* each = (const int*)&curve;
        const float* span = (const float*)tables.spans.data + 2 * each[0];
        first = splat<V>(span[0]), density = splat<V>(span[1]);
        const bool differ = any(curve != each[0]);
        for (int lane = 1; differ && lane < (int)(sizeof(V) / sizeof(float)); ++lane) {
            span = (const float*)tables.spans.data + 2 * each[lane];
            ((float*)&first)[lane] = span[0];
            ((float*)&density)[lane] = span[1];
        }
    }
    Curve<V> operator()(V x) const {
        const V one = splat<V>(1.0f), zero = splat<V>(0.0f), place = (x - first) * density;
        const auto knot = whole(clamp(place, zero, splat<V>((float)(knots - 2))));
        const V t = place - number(knot), inside = clamp(t, zero, one);
        V near[4];  // y and m of a knot, and of the next
        neighbours(values, begin + 2 * knot, near);
        const V rise = near[2] - near[0], square = 3.0f * rise - 2.0f * near[1] - near[3];
        const V cube = near[1] + near[3] - 2.0f * rise;
        const V slope = near[1] + inside * (2.0f * square + 3.0f * inside * cube);
        const V value = near[0] + inside * (near[1] + inside * (square + inside * cube));
        return {value + (t - inside) * slope, density * slope};
    }
};

template <class V> struct Millard {
    const Table<V> active_force_length, passive_force, tendon_force, velocity;
    template <class Tables>
    Millard(const Muscle<V>& m, Tables& tables)
        : active_force_length(tables, m[CURVES], 0), passive_force(tables, m[CURVES], 1),
          tendon_force(tables, m[CURVES], 2), velocity(tables, m[CURVES], 3) {}
    Curve<V> force_velocity(V v, V) const { return velocity(v); }
};

template <class V> struct Schutte {
    const Table<V> active, passive, tendon;
    template <class Tables>
    Schutte(const Muscle<V>& m, Tables& tables)
        : active(tables, m[CURVES], 0), passive(tables, m[CURVES], 1),
          tendon(tables, m[CURVES], 2) {}
    template <class Mask> static Curve<V> where(Mask acts, Curve<V> curve) {
        const V zero = splat<V>(0.0f);
        return {select(acts, curve.value, zero), select(acts, curve.slope, zero)};
    }
    Curve<V> active_force_length(V length) const {
        const Curve<V> curve = active(length);
        return where(curve.value > 0.0f, curve);
    }
    Curve<V> passive_force(V length) const {
        const Curve<V> curve = passive(length);
        return where(curve.value > 0.0f, curve);
    }
    Curve<V> tendon_force(V strain) const { return where(strain > 0.0f, tendon(strain)); }
    Curve<V> force_velocity(V velocity, V) const {
        const float k = 0.15f, q = 0.13f * k / (k + 1.0f);
        const auto shortens = velocity <= 0.0f;
        const V slower = larger(velocity, splat<V>(-1.0f));
        const V pole = 1.0f / select(shortens, k - slower, q + velocity);
        const V top = select(shortens, k * (1.0f + slower), q + 1.4f * velocity);
        const V numerator = select(shortens, splat<V>(k * (1.0f + k)), splat<V>(q * 0.4f));
        const V slope = numerator * pole * pole;
        return {top * pole, select(velocity > -1.0f, slope, splat<V>(0.0f))};
    }
};

template <class V> struct Thelen {
    const V toe_force = splat<V>(0.33f);
    V active_width, passive_rate, passive_scale, toe_strain, toe_rate, toe_scale, stiffness;
    V shape, limit, q, end;
    template <class Tables> Thelen(const Muscle<V>& m, Tables&) {
        active_width = 1.0f / m[ACTIVE_WIDTH];
        passive_rate = m[PASSIVE_SHAPE] / m[PASSIVE_STRAIN];
        passive_scale = 1.0f / (decay(m[PASSIVE_SHAPE]) - 1.0f);
        toe_strain = TOE_SHARE * m[TENDON_STRAIN];
        toe_rate = 3.0f / toe_strain;
        toe_scale = splat<V>(0.33f / TOE_GROWTH);
        stiffness = 0.67f / (m[TENDON_STRAIN] - toe_strain);
        shape = 1.0f / m[VELOCITY_SHAPE];
        limit = m[ECCENTRIC_MULTIPLIER];
        q = (2.0f + 2.0f * shape) / (limit - 1.0f);
        const V last = m[EXTRAPOLATION_THRESHOLD] * limit;
        end = (last - 1.0f) / (q * (limit - last));
    }
    Curve<V> active_force_length(V length) const {
        const V stretch = length - 1.0f, value = decay(-stretch * stretch * active_width);
        return {value, -2.0f * stretch * active_width * value};
    }
    Curve<V> passive_force(V length) const {
        const V stretch = at_least(0.0f, length - 1.0f);
        const Curve<V> rise = growth(passive_rate * stretch);
        const V slope = passive_rate * rise.slope * passive_scale;
        return {(rise.value - 1.0f) * passive_scale, select(stretch > 0.0f, slope, splat<V>(0.0f))};
    }
    Curve<V> tendon_force(V strain) const {
        const V zero = splat<V>(0.0f), toe = clamp(strain, zero, toe_strain), rise = decay(toe_rate * toe);
        const auto line = strain > toe_strain;
        const V slope = select(line, stiffness, toe_scale * toe_rate * rise);
        return {select(line, toe_force + stiffness * (strain - toe_strain), toe_scale * (rise - 1.0f)),
                select(strain > 0.0f, slope, zero)};
    }
    Curve<V> force_velocity(V velocity, V activation) const {
        const V k = 0.25f + 0.75f * activation;
        const auto shortens = velocity <= 0.0f;
        const V v = select(shortens, larger(velocity, -k), smaller(velocity, k * end));
        const V pole = 1.0f / select(shortens, k - v * shape, k + q * v);
        const V numerator = select(shortens, (1.0f + shape) * k, q * k * (limit - 1.0f));
        const V top = select(shortens, k + v, k + q * limit * v), slope = numerator * pole * pole;
        return {top * pole + slope * (velocity - v), slope};
    }
};

template <class V> struct DeGroote {
    V width, passive_rate, passive_scale, offset, tendon_rate;
    template <class Tables> DeGroote(const Muscle<V>& m, Tables&) {
        width = 1.0f / m[ACTIVE_WIDTH];
        passive_rate = 4.0f / m[PASSIVE_STRAIN];
        offset = decay(-0.8f * passive_rate);
        passive_scale = m[PASSIVE_SCALE] / (54.5981500331f - offset);
        tendon_rate = 1.7917594692f / m[TENDON_STRAIN];
    }
    static Curve<V> bell(V x, float height, float centre, float width, float skew) {
        const V spread = 1.0f / at_least(1e-3f, width + skew * x), z = (x - centre) * spread;
        const V value = height * decay(-0.5f * z * z);
        return {value, -value * z * (1.0f - skew * z) * spread};
    }
    Curve<V> active_force_length(V length) const {
        const V x = (length - 1.0f) * width + 1.0f;
        const Curve<V> a = bell(x, 0.8150671134f, 1.0550334290f, 0.1623845736f, 0.0633034485f);
        const Curve<V> b = bell(x, 0.4330049844f, 0.7167754134f, -0.0299471170f, 0.2003568473f);
        const Curve<V> c = bell(x, 0.1f, 1.0f, 0.3535533906f, 0.0f);
        return {a.value + b.value + c.value, (a.slope + b.slope + c.slope) * width};
    }
    Curve<V> passive_force(V length) const {
        const Curve<V> rise = growth(passive_rate * (length - 1.0f));
        return {passive_scale * (rise.value - offset), passive_scale * passive_rate * rise.slope};
    }
    Curve<V> tendon_force(V strain) const {
        const Curve<V> rise = growth(tendon_rate * strain);
        return {0.2f * rise.value - 0.2f, 0.2f * tendon_rate * rise.slope};
    }
    Curve<V> force_velocity(V velocity, V) const {
        const V x = -8.149f * velocity - 0.374f, size = absolute(x), hypotenuse = root(1.0f + x * x);
        const V asinh = logarithm(size + hypotenuse);
        return {-0.3211346128f * select(x < 0.0f, -asinh, asinh) + 0.8825327733f,
                (0.3211346128f * 8.149f) / hypotenuse};
    }
};

template <class V> struct Pull { V force, by_z, by_velocity; };

// `fiber_pull` with what does not change as z does.
template <class V, class Law> struct Fiber {
    const Law& law;
    V activation, drive, width, optimal, scale, damping;

    Fiber(const Law& law, const Muscle<V>& m, V activation, V strength)
        : law(law), activation(activation), drive(activation * strength), width(m[FIBER_WIDTH]),
          optimal(1.0f / m[OPTIMAL_FIBER_LENGTH]), scale(optimal / m[MAX_CONTRACTION_VELOCITY]),
          damping(m[FIBER_DAMPING]) {}

    Pull<V> pull(V z, V velocity, V before, V per_step) const {
        const V length = root(z * z + width * width), over = 1.0f / length, cosine = z * over;
        const V turn = (1.0f - cosine * cosine) * over;
        const V speed = ((length - before) * per_step + velocity * cosine) * scale;
        const V speed_slope = (cosine * per_step + velocity * turn) * scale;
        const Curve<V> active = law.active_force_length(length * optimal);
        const Curve<V> passive = law.passive_force(length * optimal);
        const Curve<V> factor = law.force_velocity(speed, activation);
        const V force = drive * active.value * factor.value + passive.value + damping * speed;
        const V by_speed = drive * active.value * factor.slope + damping;
        const V by_length = (drive * active.slope * factor.value + passive.slope) * cosine * optimal;
        return {force * cosine, (by_length + by_speed * speed_slope) * cosine + force * turn,
                by_speed * cosine * cosine * scale};
    }
};

template <class V, class Law>
INLINE Fiber<V, Law> fiber_under(const Law& law, const Muscle<V>& m, V activation, V strength) {
    return Fiber<V, Law>(law, m, activation, strength);
}

// `equilibrium` of a step of muscles in a mask; of others nothing is known.
template <class V> struct Equilibrium { V z, stiffness, slope; };
template <class V, class Law>
INLINE Equilibrium<V> step_to_equilibrium(const Fiber<V, Law>& fiber, typename MaskOf<V>::type busy, V slack,
                                          V tendon, V shortest, V before, V per_step, V start, V small) {
    const V zero = splat<V>(0.0f), square = before * before - fiber.width * fiber.width;
    V low = shortest, high = larger(larger(slack, low), root(larger(square, low * low)));
    const V near = clamp(NEWTON_SPEED / (fiber.scale * per_step), small, NEWTON * small);
    V z = clamp(start, low, high), last = splat<V>(1e30f);
    Equilibrium<V> found = {z, zero, zero};
    for (int i = 0; i < 80 && any(busy); ++i) {
        const Pull<V> pull = fiber.pull(z, zero, before, per_step);
        const Curve<V> force = fiber.law.tendon_force((slack - z) * tendon);
        const V stiffness = force.slope * tendon, residual = pull.force - force.value;
        const auto less = residual < 0.0f;
        low = select(less, z, low);
        high = select(less, high, z);
        const V both = pull.by_z + stiffness, nearer = z - residual / both;
        const auto newton = (both > 0.0f) & (nearer >= low) & (nearer <= high) &
                            opposite(absolute(residual) > 0.5f * last);
        const V next = select(newton, nearer, 0.5f * (low + high)), step = next - z;
        last = absolute(residual);
        found.stiffness = select(busy, stiffness, found.stiffness);
        found.slope = select(busy, pull.by_z, found.slope);
        z = select(busy, next, z);
        busy = busy & (absolute(step) > select(newton, near, small));
    }
    found.z = z;
    return found;
}

// `hill_activation_step`: (a that pulls, a after dt).
template <class V> INLINE V degroote_activation_rate(V excitation, V activation, V rise, V fall) {
    const V z = 0.5f + 1.5f * activation, gap = excitation - activation, y = 0.1f * gap, s = y * y;
    const V f = 0.5f * y * (1.0f - s * (1.0f / 3.0f - s * (2.0f / 15.0f - s * (17.0f / 315.0f))));
    return ((0.5f + f) / (rise * z) + (0.5f - f) * z / fall) * gap;
}
template <class V>
INLINE V hill_activation_step(int law, V dt, bool midstep, V u, V a, V rise, V fall, V& middle) {
    const V low = smaller(a, u), high = larger(a, u);
    if (law == DEGROOTE) {
        middle = clamp(a + 0.5f * dt * degroote_activation_rate(u, a, rise, fall), low, high);
        return clamp(a + dt * degroote_activation_rate(u, middle, rise, fall), low, high);
    }
    if (law == SCHUTTE) {
        const V share = select(u >= a, u, splat<V>(0.0f)), rate = (1.0f - share) / fall + share / rise;
        middle = clamp(u + (a - u) * decay(-0.5f * dt * rate), low, high);
        return clamp(u + (a - u) * decay(-dt * rate), low, high);
    }
    if (midstep)
        middle = clamp(activation_after(0.5f * dt, u, a, rise, fall), low, high);
    return clamp(activation_after(dt, u, a, rise, fall), low, high);
}

template <class V, class Params, class Anatomy, class Times, class Row, class States, class Results,
          class Bias>
void contract_hill_block(Block<V>& block, Params& params, Anatomy& anatomy, Times& timestep, bool midstep,
                         float implicitness, Row& ctrl, Row& actuator_length, Row& actuator_velocity,
                         States& fibers, Results& results, Bias& actuator_biasprm) {
    const int num_muscles = fibers.activation.shape[1];
    const V dt = block.model(timestep)[0], zero = splat<V>(0.0f), one = splat<V>(1.0f), rate = 1.0f / dt;
    const auto moves = dt > 0.0f;
    const Field<V> tau_act = block.model(params.activation_time_constant);
    const Field<V> tau_deact = block.model(params.deactivation_time_constant);
    const Field<V> rows = block.model(params.muscles);
    const float* bounds = (const float*)params.excitation_range.data;
    const V *control = block.in(ctrl), *activation = block.in(fibers.activation);
    const bool remembers = fibers.fiber_length.shape[0] > 0;  // some tendon is elastic
    const V* fiber_length = remembers ? block.in(fibers.fiber_length) : nullptr;
    const V* expected_lengths = remembers ? block.in(fibers.expected_length) : nullptr;
    const V* shares = remembers ? block.in(fibers.fiber_share) : nullptr;
    Pulling<V, Anatomy, Results, Bias> pulling(block, anatomy, results, actuator_biasprm, actuator_length,
                                               actuator_velocity);
    V* activation_to = block.template out<V>(fibers.activation);
    V* length_to = remembers ? block.template out<V>(fibers.fiber_length) : nullptr;
    V* expected_to = remembers ? block.template out<V>(fibers.expected_length) : nullptr;
    V* share_to = remembers ? block.template out<V>(fibers.fiber_share) : nullptr;

    for (int i = 0; i < num_muscles; ++i) {
        const Muscle<V> m{rows, NUM_WORDS * i};
        const int kind = ints_of(params.muscles, block.first % params.muscles.shape[0])[NUM_WORDS * i + LAW];
        const auto rigid = bits(m[RIGID]) == 1, elastic = opposite(rigid);
        const bool any_rigid = any(rigid), any_elastic = any(elastic);
        const V least = splat<V>(bounds[2 * i]), most = splat<V>(bounds[2 * i + 1]);
        const V bound = clamp(control[params.actuator_id.data[i]], least, most);
        const V u = larger(m[MINIMUM_ACTIVATION], bound), a = larger(m[MINIMUM_ACTIVATION], activation[i]);
        V pulls = a;
        const bool middle = any_rigid && midstep;
        const V after = hill_activation_step(kind, dt, middle, u, a, tau_act[i], tau_deact[i], pulls);
        pulls = select(elastic, after, midstep ? pulls : a);
        pulling.fetch(i);
        const V length = pulling.length[i], velocity = pulling.velocity[i];
        V before = remembers ? fiber_length[i] : zero, expected = length, share = zero;
        const V shortest = m[SHORTEST_FIBER], slack = m[TENDON_SLACK_LENGTH], width = m[FIBER_WIDTH];
        auto contract = [&](const auto& law) {
            const auto fiber = fiber_under(law, m, pulls, pulling.strength[i]);
            V z = zero, force = zero, by_velocity = zero;
            if (any_rigid) {
                const V free = length - slack;
                z = larger(free, shortest);
                const Pull<V> pull = fiber.pull(z, velocity, zero, zero);
                const auto tight = (free > shortest) & (pull.force > 0.0f);
                force = select(tight, pull.force, zero);
                by_velocity = select(tight, pull.by_velocity, zero);
            }
            if (any_elastic) {
                const V tendon = 1.0f / slack, square = before * before - width * width;
                const V least = root(larger(square, shortest * shortest));
                const V now = larger(least + shares[i] * (length - expected_lengths[i]), shortest);
                before = select(before >= 0.0f, root(now * now + width * width), before);
                const V small = TOLERANCE * (m[OPTIMAL_FIBER_LENGTH] + absolute(slack)), way = dt * velocity;
                const Equilibrium<V> found =
                    step_to_equilibrium(fiber, elastic & moves, length + way - slack, tendon, shortest,
                                        root(now * now + width * width), rate, now + way, small);
                const V tension = law.tendon_force((length - now - slack) * tendon).value;
                const V both = found.slope + found.stiffness;
                const auto steps = elastic & moves, gives = (tension > 0.0f) & (found.slope > 0.0f);
                share = select(steps & (both > 0.0f), clamp(found.stiffness / both, zero, one), zero);
                expected = select(steps, length + way, length);
                z = select(elastic, select(moves, found.z, now), z);
                force = select(elastic, larger(tension, zero), force);
                by_velocity = select(elastic, select(gives, dt * share * found.slope, zero), by_velocity);
            }
            V fiber_after = root(z * z + width * width);
            const auto lost = elastic & opposite(before >= 0.0f);  // no length, or none at all: a fault
            fiber_after = select(lost, splat<V>(wp::cast<float>(0x7fc00000)), fiber_after);
            const V peak = pulling.transmission[i] * m[MAX_ISOMETRIC_FORCE];
            const V pull = peak * select(lost, zero, force), slope = peak * select(lost, zero, by_velocity);
            if (pulling.works) {
                V speed = velocity * z / fiber_after;
                speed = select(elastic & moves, (fiber_after - before) * rate, speed);
                const V active = law.active_force_length(fiber_after * fiber.optimal).value;
                const V factor = law.force_velocity(speed * fiber.scale, pulls).value;
                pulling.work[i] = pulling.worked[i] + dt * larger(pulls * active * factor, zero);
            }
            activation_to[i] = after;
            if (remembers) {
                length_to[i] = fiber_after;
                expected_to[i] = expected;
                share_to[i] = share;
            }
            pulling.publish(i, pull, implicitness > 0.0f ? implicitness * slope : zero);
        };
        if (kind == MILLARD)
            contract(Millard<V>(m, params.tables));
        else if (kind == THELEN)
            contract(Thelen<V>(m, params.tables));
        else if (kind == SCHUTTE)
            contract(Schutte<V>(m, params.tables));
        else
            contract(DeGroote<V>(m, params.tables));
    }
    block.store(fibers.activation, activation_to, 0, num_muscles);
    if (remembers) {
        block.store(fibers.fiber_length, length_to, 0, num_muscles);
        block.store(fibers.expected_length, expected_to, 0, num_muscles);
        block.store(fibers.fiber_share, share_to, 0, num_muscles);
    }
    pulling.store(num_muscles);
}
}  // namespace lanes
