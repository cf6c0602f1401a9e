// Body of the native function `solve_world` (contact_solve.py, which explains the method); WIDTH and the
// overflow bits are defined before it. Degrees of freedom are padded to WIDTH, rows to whole vectors.

#pragma clang diagnostic ignored "-Wvla-cxx-extension"
typedef float lanes __attribute__((ext_vector_type(8)));
typedef float loose_lanes __attribute__((ext_vector_type(8), aligned(4)));
typedef float loose_half __attribute__((ext_vector_type(4), aligned(4)));
typedef double wide __attribute__((ext_vector_type(8)));
typedef bool bits __attribute__((ext_vector_type(8)));
constexpr int BLOCKS = WIDTH / 8, WORDS = WIDTH / 64 + 1;
const lanes lane_number = {0, 1, 2, 3, 4, 5, 6, 7};
constexpr float INF = 3.4e38f, TINY = 1e-15f;
enum { SATISFIED, QUADRATIC, LINEARNEG, LINEARPOS };  // mjtConstraintState

auto at = [](lanes* vector, int i) -> float& { return ((float*)vector)[i]; };
auto sum = [](auto v) {
    auto half = v.lo + v.hi;
    auto quarter = half.lo + half.hi;
    return quarter.x + quarter.y;
};
auto widen = [](lanes v) { return __builtin_convertvector(v, wide); };
auto dot = [&](const lanes* a, const lanes* b) {
    lanes total = 0.0f;
    for (int k = 0; k < BLOCKS; ++k)
        total += a[k] * b[k];
    return sum(total);
};
auto add = [](lanes* to, float factor, const lanes* from, int blocks = BLOCKS) {
    for (int k = 0; k < blocks; ++k)
        to[k] += factor * from[k];
};
// Give `use` each column below `end` in which a row is not zero; a bit for each, in words of 64.
auto for_nonzeros = [](const lanes* row, int end, auto use) {
    for (int word = 0; word < WORDS; ++word) {
        unsigned long long columns = 0;
        for (int k = 0; k < 8 && 8 * word + k < BLOCKS; ++k) {
            const auto found = __builtin_convertvector(row[8 * word + k] != 0.0f, bits);
            columns |= (unsigned long long)__builtin_bit_cast(unsigned char, found) << 8 * k;
        }
        int left = end - 64 * word;
        if (WORDS > 1)
            left = wp::min(wp::max(left, 0), 64);
        columns &= WORDS == 1 || left < 64 ? (1ull << left) - 1 : ~0ull;
        for (; columns; columns &= columns - 1)
            use(64 * word + __builtin_ctzll(columns));
    }
};
auto blocks_up_to = [](int column) { return column / 8 + 1; };

const int n = qfrc_smooth.shape[0];
const int ne = counts.ne[world], nf = counts.nf[world];
const int num_rows = wp::min(counts.nefc[world], rows.aref.shape[1]);
const int row_blocks = (num_rows + 7) / 8;

// Part: gather
// Inertia, symmetric, and what a row needs. J is gathered: it comes dense or sparse, here rows are dense.
lanes mass[WIDTH][BLOCKS], J[num_rows + 1][BLOCKS];
lanes x[BLOCKS], Mx[BLOCKS], smooth[BLOCKS], pull[BLOCKS], gradient[BLOCKS], search[BLOCKS], Ms[BLOCKS];
lanes D[row_blocks + 1], low[row_blocks + 1], high[row_blocks + 1], loss[row_blocks + 1];
lanes residual[row_blocks + 1], change[row_blocks + 1], force[row_blocks + 1];
int state[num_rows + 1];

for (int i = 0; i < WIDTH; ++i)
    for (int k = 0; k < BLOCKS; ++k)
        mass[i][k] = 0.0f;
float trace = 0.0f;
for (int i = 0; i < n; ++i) {
    const int begin = inertia.M_rowadr[i], end = begin + inertia.M_rownnz[i];
    for (int k = begin; k < end; ++k) {
        const int j = inertia.M_colind[k];
        at(mass[i], j) = at(mass[j], i) = M[k];
    }
    trace += M[end - 1];
}
const float scale = 1.0f / wp::max(TINY, trace);

for (int k = 0; k < BLOCKS; ++k)
    x[k] = Mx[k] = smooth[k] = 0.0f;
for (int i = 0; i < n; ++i) {
    at(x, i) = qacc_warmstart[i];
    at(smooth, i) = qfrc_smooth[i];
}
for (int j = 0; j < n; ++j)
    add(Mx, at(x, j), mass[j]);

// Every row pulls with -D residual between `low` and `high` and with a constant force outside: an equality
// has no bounds, friction loss is bounded on both sides, a limit or contact never pulls above zero.
for (int b = 0; b < row_blocks; ++b) {
    D[b] = loss[b] = residual[b] = change[b] = 0.0f;
    low[b] = -INF;
    high[b] = INF;
}
for (int i = 0; i < num_rows; ++i) {
    for (int k = 0; k < BLOCKS; ++k)
        J[i][k] = 0.0f;
    if (rows.J_rownnz.shape[1] > 0) {
        const int begin = wp::index(rows.J_rowadr, world, i);
        const int end = begin + wp::index(rows.J_rownnz, world, i);
        for (int k = begin; k < end; ++k)
            at(J[i], wp::index(rows.J_colind, world, 0, k)) = wp::index(rows.J, world, 0, k);
    } else {
        const float* from = &wp::index(rows.J, world, i, 0);
        for (int k = 0; k < n / 8; ++k)
            J[i][k] = *(const loose_lanes*)(from + 8 * k);
        if (n % 8) {
            J[i][BLOCKS - 1].lo = *(const loose_half*)(from + n / 8 * 8);
            if (n % 8 > 4)
                J[i][BLOCKS - 1].hi = *(const loose_half*)(from + n / 8 * 8 + 4);
            J[i][BLOCKS - 1] = lane_number < (float)(n % 8) ? J[i][BLOCKS - 1] : (lanes)0.0f;
        }
    }
    at(D, i) = wp::index(rows.D, world, i);
    at(residual, i) = dot(J[i], x) - wp::index(rows.aref, world, i);
    if (i >= ne + nf) {
        at(high, i) = 0.0f;
    } else if (i >= ne) {
        const float limit = wp::index(rows.frictionloss, world, i);
        at(loss, i) = limit;
        at(high, i) = limit / at(D, i);
        at(low, i) = -limit / at(D, i);
    }
    state[i] = SATISFIED;
}

// H = M + sum of D J'J over the quadratic rows, lower triangle. Vector writes leave junk right of the
// diagonal, which nothing reads: `factorize` clears it before a row of L is used.
lanes H[WIDTH][BLOCKS], L[WIDTH][BLOCKS];
lanes inverse_pivot[BLOCKS] = {};
auto copy = [](lanes (*to)[BLOCKS], lanes (*from)[BLOCKS]) {
    for (int i = 0; i < WIDTH; ++i)
        for (int k = 0; k < BLOCKS; ++k)
            to[i][k] = from[i][k];
};
auto add_row_to_H = [&](int i, float weight) {
    for_nonzeros(J[i], n, [&](int c) { add(H[c], weight * at(J[i], c), J[i], blocks_up_to(c)); });
};
// H = L' P L with unit lower L and pivots P, last row first: zeros of the kinematic tree stay zero.
auto factorize = [&]() __attribute__((noinline)) {
    copy(L, H);
    for (int k = n - 1; k >= 0; --k) {
        const float inverse = 1.0f / wp::max(TINY, at(L[k], k));
        L[k][k / 8] = lane_number < (float)(k % 8) ? L[k][k / 8] : (lanes)0.0f;
        for_nonzeros(L[k], k, [&](int c) { add(L[c], -inverse * at(L[k], c), L[k], blocks_up_to(c)); });
        for (int b = 0; b < blocks_up_to(k); ++b)
            L[k][b] *= inverse;
        at(inverse_pivot, k) = inverse;
    }
};
// search = -(L' P L)^-1 gradient; returns the Newton decrement, gradient' H^-1 gradient.
auto solve = [&]() __attribute__((noinline)) {
    for (int k = 0; k < BLOCKS; ++k)
        search[k] = -gradient[k];
    for (int k = n - 1; k >= 0; --k)
        add(search, -at(search, k), L[k], blocks_up_to(k));
    for (int k = 0; k < BLOCKS; ++k)
        search[k] *= inverse_pivot[k];
    for (int k = 0; k < n; ++k) {
        lanes total = 0.0f;
        for (int b = 0; b < blocks_up_to(k); ++b)
            total += L[k][b] * search[b];
        search[k / 8] -= lane_number == (float)(k % 8) ? (lanes)sum(total) : (lanes)0.0f;
    }
    return -dot(gradient, search);
};

// Forces and states of all rows at the present residual; H follows the rows whose state flips.
auto update_states = [&]() __attribute__((noinline)) {
    bool flipped = false;
    for (int b = 0; b < row_blocks; ++b) {
        lanes r = residual[b];
        force[b] = r <= low[b] ? loss[b] : (r >= high[b] ? -loss[b] : -D[b] * r);
    }
    for (int i = 0; i < num_rows; ++i) {
        const float r = at(residual, i);
        const int above = i < ne + nf ? LINEARPOS : SATISFIED;
        const int now = r <= at(low, i) ? LINEARNEG : r >= at(high, i) ? above : QUADRATIC;
        if (now == state[i])
            continue;
        flipped = true;
        if (now == QUADRATIC)
            add_row_to_H(i, at(D, i));
        else if (state[i] == QUADRATIC)
            add_row_to_H(i, -at(D, i));
        state[i] = now;
    }
    return flipped;
};
// pull = J' force, gradient = M x - smooth - pull; returns the gradient's norm.
auto update_gradient = [&]() __attribute__((noinline)) {
    for (int k = 0; k < BLOCKS; ++k)
        pull[k] = 0.0f;
    for (int i = 0; i < num_rows; ++i)
        if (at(force, i) != 0.0f)
            add(pull, at(force, i), J[i]);
    for (int k = 0; k < BLOCKS; ++k)
        gradient[k] = Mx[k] - smooth[k] - pull[k];
    return wp::sqrt(dot(gradient, gradient));
};

// The cost along x + step search: its slope and curvature, and how much it falls from step 0.
double smooth_slope, smooth_curvature;
auto probe = [&](double step, double& slope, double& curvature) __attribute__((noinline)) {
    wide slopes = 0.0, curvatures = 0.0;
    for (int b = 0; b < row_blocks; ++b) {
        const wide v = widen(change[b]), d = widen(D[b]), most = widen(loss[b]);
        const wide r = widen(residual[b]) + step * v;
        const auto below = r <= widen(low[b]), above = r >= widen(high[b]);
        slopes -= v * (below ? most : (above ? -most : -d * r));
        curvatures += (below | above) ? (wide)0.0 : v * v * d;
    }
    slope = smooth_slope + step * smooth_curvature + sum(slopes);
    curvature = smooth_curvature + sum(curvatures);
};
auto row_cost = [&](int b, double step) {
    const wide d = widen(D[b]), most = widen(loss[b]), lowest = widen(low[b]), highest = widen(high[b]);
    const wide r = widen(residual[b]) + step * widen(change[b]);
    const wide above = most * (r - 0.5 * highest), below = most * (0.5 * lowest - r);
    return r <= lowest ? below : (r >= highest ? above : 0.5 * d * r * r);
};
auto improvement = [&](double step) __attribute__((noinline)) {
    wide falls = 0.0;
    for (int b = 0; b < row_blocks; ++b)
        falls += row_cost(b, 0.0) - row_cost(b, step);
    return sum(falls) - step * (smooth_slope + 0.5 * step * smooth_curvature);
};
const float tolerance = options.tolerance[world % options.tolerance.shape[0]];
auto below_tolerance = [&](float value) { return !(scale * value >= tolerance); };  // NaN: nothing to gain

// Root of the slope, which rises and is piecewise linear: Newton's method, halving where it leaves the
// bracket. NaN passes through, so that a broken world is seen to be broken.
auto find_step = [&]() __attribute__((noinline)) {
    double slope, curvature, low_step = 0.0, high_step = INF;
    probe(0.0, slope, curvature);
    if (slope >= 0.0)
        return 0.0;
    const double enough = wp::max(1e-9 * -slope, 1e-6 * tolerance / scale);  // above the rounding of the slope
    double step = -slope / curvature;
    for (int i = 0; i < options.ls_iterations; ++i) {
        probe(step, slope, curvature);
        if (!(slope > enough || slope < -enough))
            return step;
        (slope < 0.0 ? low_step : high_step) = step;
        const double next = step - slope / curvature;
        step = next > low_step && next < high_step ? next : 0.5 * (low_step + high_step);
    }
    result.overflow[world] |= LINE_SEARCH_OVERFLOW;
    return step;
};

// Part: first Hessian
copy(H, mass);
update_states();
// Part: gradients
float norm = update_gradient();
// Part: factors
factorize();
// Part: substitutions
float decrement = solve();
int iterations = 0;
while (true) {
    // Part: products
    for (int k = 0; k < BLOCKS; ++k)
        Ms[k] = 0.0f;
    for (int j = 0; j < n; ++j)
        add(Ms, at(search, j), mass[j]);
    for (int i = 0; i < num_rows; ++i)
        at(change, i) = dot(J[i], search);
    wide slopes = 0.0, curvatures = 0.0;
    for (int k = 0; k < BLOCKS; ++k) {
        slopes += widen(search[k]) * (widen(Mx[k]) - widen(smooth[k]));
        curvatures += widen(search[k]) * widen(Ms[k]);
    }
    smooth_slope = sum(slopes);
    smooth_curvature = sum(curvatures);

    // Part: line searches
    const double step = find_step();
    const float gain = improvement(step);
    add(x, step, search);
    add(Mx, step, Ms);
    for (int b = 0; b < row_blocks; ++b)
        residual[b] += (float)step * change[b];
    ++iterations;

    // A step that is to gain less than the tolerance is the last; without it, light touches are off by 1e-3.
    bool done = step == 0.0 || (gain > 0.0f && below_tolerance(gain)) || below_tolerance(0.5f * decrement);
    // Part: states and Hessian
    const bool flipped = update_states();
    // Part: gradients
    // Where nothing flipped, the cost was quadratic all along the step, so the gradient only shrank.
    norm = flipped ? update_gradient() : norm * (step < 1.0 ? 1.0 - step : step - 1.0);
    done = done || below_tolerance(norm);
    if (done || iterations == options.iterations) {
        if (!done)
            result.overflow[world] |= ITERATIONS_OVERFLOW;
        if (!flipped)
            update_gradient();
        break;
    }
    // Part: factors
    if (flipped)
        factorize();
    else
        norm = update_gradient();
    // Part: substitutions
    decrement = solve();
}

// Part: results
for (int i = 0; i < n; ++i) {
    qacc[i] = at(x, i);
    qfrc_constraint[i] = at(pull, i);
    wp::index(result.Ma, world, i) = at(Mx, i);
}
for (int i = 0; i < num_rows; ++i) {
    wp::index(result.force, world, i) = at(force, i);
    wp::index(result.state, world, i) = state[i];
}
result.niter[world] = iterations;
