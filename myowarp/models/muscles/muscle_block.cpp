// What the muscles of a block have in common, whatever their law (lanes.cpp says what V is): activation, the
// paths that they pull, and what they publish.
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

// The paths that muscles pull, and what they publish: `MuscleResults`, and `affine_bias` for the engine.
template <class V, class Anatomy, class Results, class Bias> struct Pulling {
    static constexpr int LANES = LanesOf<V>::number;
    Block<V>& block;
    Results& results;
    Bias& biasprm;
    bool own_paths, works;
    const int* paths[LANES];  // a muscle may pull another one in each world
    const Field<V> strength, transmission;
    const V *worked, *lengths, *velocities;
    V *work, *tension, *damping, *length, *velocity;

    template <class Row>
    Pulling(Block<V>& block, Anatomy& anatomy, Results& results, Bias& biasprm, Row& actuator_length,
            Row& actuator_velocity)
        : block(block), results(results), biasprm(biasprm), own_paths(anatomy.path.shape[0] > 1),
          works(results.workload.shape[0] > 0), strength(block.model(anatomy.strength)),
          transmission(block.model(anatomy.transmission)),
          worked(works ? block.in(results.workload) : nullptr), lengths(block.in(actuator_length)),
          velocities(block.in(actuator_velocity)),
          work(works ? block.template out<V>(results.workload) : nullptr),
          tension(block.template out<V>(results.tension)), damping(block.template out<V>(results.damping)),
          length(block.template out<V>(results.length)), velocity(block.template out<V>(results.velocity)) {
        for (int lane = 0; lane < LANES; ++lane) {
            const int world = block.first + (lane < block.count ? lane : block.count - 1);
            paths[lane] = ints_of(anatomy.path, world % anatomy.path.shape[0]);
        }
    }
    V of_path(const V* values, int m) const {
        V found = values[paths[0][m]];
        for (int lane = 1; own_paths && lane < LANES; ++lane)
            in_lane(found, lane) = in_lane(values[paths[lane][m]], lane);
        return found;
    }
    // Length and velocity of the path of a muscle.
    void fetch(int m) {
        length[m] = of_path(lengths, m);
        velocity[m] = of_path(velocities, m);
    }
    void publish(int m, V pull, V drag) {
        tension[m] = pull;
        damping[m] = drag;
        const V constant = drag * velocity[m] - pull, factor = -drag;
        for (int lane = 0; lane < block.count; ++lane) {
            float* affine = row_of(biasprm, block.first + lane) + 10 * paths[lane][m];
            memset(affine, 0, 10 * sizeof(float));
            affine[0] = in_lane(constant, lane);
            affine[2] = in_lane(factor, lane);
        }
    }
    void store(int num_muscles) {
        block.store(results.tension, tension, 0, num_muscles);
        block.store(results.damping, damping, 0, num_muscles);
        block.store(results.length, length, 0, num_muscles);
        block.store(results.velocity, velocity, 0, num_muscles);
        if (works)
            block.store(results.workload, work, 0, num_muscles);
    }
};
}  // namespace lanes
