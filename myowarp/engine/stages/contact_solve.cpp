// Body of the loop over worlds of the native function `solve_worlds` (contact_solve.py, which explains the
// method), after contact_frame.cpp; WIDTH and the overflow bits are defined before it. Degrees of freedom are
// padded to WIDTH, rows to whole vectors.

if (memory.solved.data[world])
    continue;
#pragma clang diagnostic ignored "-Wvla-cxx-extension"
typedef float lanes __attribute__((ext_vector_type(8)));
typedef float half __attribute__((ext_vector_type(4)));
typedef float loose_half __attribute__((ext_vector_type(4), aligned(4)));
typedef int numbers __attribute__((ext_vector_type(8)));
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
// Of the first three rows of a frame, their sums with a vector; the fourth is 0.
auto dots = [](const lanes (*rows)[BLOCKS], const lanes* b) {
    lanes total[3] = {};
    for (int k = 0; k < BLOCKS; ++k)
        for (int axis = 0; axis < 3; ++axis)
            total[axis] += rows[axis][k] * b[k];
    const half x = total[0].lo + total[0].hi, y = total[1].lo + total[1].hi, z = total[2].lo + total[2].hi;
    const half xy = __builtin_shufflevector(x, y, 0, 4, 1, 5) + __builtin_shufflevector(x, y, 2, 6, 3, 7);
    const half zs = __builtin_shufflevector(z, z, 0, 2, 1, 3), z0 = zs + zs.zwxy;
    return (half){xy.x + xy.z, xy.y + xy.w, z0.x + z0.y, 0.0f};
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
auto add_three = [](lanes* to, half factors, const lanes (*rows)[BLOCKS], int blocks = BLOCKS) {
    for (int k = 0; k < blocks; ++k)
        to[k] += factors.x * rows[0][k] + factors.y * rows[1][k] + factors.z * rows[2][k];
};
auto blocks_up_to = [](int column) { return column / 8 + 1; };

const float *M = &wp::index(M_in, world, 0), *qfrc_smooth = &wp::index(qfrc_smooth_in, world, 0);
const float* qacc_warmstart = &wp::index(qacc_warmstart_in, world, 0);
float *qacc = &wp::index(qacc_out, world, 0), *qfrc_constraint = &wp::index(qfrc_constraint_out, world, 0);
const int n = qacc_out.shape[1];
const int ne = counts.ne[world], nf = counts.nf[world];
const int num_rows = wp::min(counts.nefc[world], rows.aref.shape[1]);
const int row_blocks = (num_rows + 7) / 8;
// Rows from here on are edges of contacts, whose frames stand for them: J has normal, tangents and turns.
// Three axes and four edges are always computed: without friction, what the next frame overwrites.
const int num_plain = moving.in_solver ? wp::min(ne + nf + counts.nl[world], num_rows) : num_rows;
struct Frame {
    int row, num_rows, first, num_axes;  // edges; rows of J
    half slopes;                         // of four edges
    const float* friction;
    unsigned long long dofs[WORDS];
};
int num_frames = 0;

// Part: gather
// Inertia, symmetric, and what a row needs. J is gathered: it comes dense or sparse, here rows are dense.
lanes mass[WIDTH][BLOCKS], J[num_rows + 6][BLOCKS];
lanes x[BLOCKS], Mx[BLOCKS], smooth[BLOCKS], pull[BLOCKS], gradient[BLOCKS], search[BLOCKS], Ms[BLOCKS];
Frame frames[num_rows - num_plain + 1];
lanes D[row_blocks + 1], low[row_blocks + 1], high[row_blocks + 1], loss[row_blocks + 1];
lanes residual[row_blocks + 1], change[row_blocks + 1], force[row_blocks + 1];
lanes weight[row_blocks + 1], heavier[row_blocks + 1];
numbers state[row_blocks + 1];

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
for (int b = 0; b <= row_blocks; ++b) {
    D[b] = loss[b] = residual[b] = change[b] = weight[b] = heavier[b] = force[b] = 0.0f;
    low[b] = -INF;
    high[b] = INF;
    state[b] = SATISFIED;
}
for (int i = 0; i < num_plain; ++i) {
    for (int k = 0; k < BLOCKS; ++k)
        J[i][k] = 0.0f;
    if (rows.J_rownnz.shape[1] > 0) {
        const int begin = wp::index(rows.J_rowadr, world, i);
        const int end = begin + wp::index(rows.J_rownnz, world, i);
        for (int k = begin; k < end; ++k)
            at(J[i], wp::index(rows.J_colind, world, 0, k)) = wp::index(rows.J, world, 0, k);
    } else {
        memcpy(J[i], &wp::index(rows.J, world, i, 0), n * sizeof(float));
    }
}
for (int row = num_plain, first = num_plain; row < num_rows;) {
    const int conid = wp::index(rows.id, world, row), num_axes = contacts.dim.data[conid];
    const float* friction = friction_of(conid);
    Frame& frame = frames[num_frames++];
    frame = {row, wp::min(wp::max(1, 2 * (num_axes - 1)), num_rows - row), first, num_axes};
    frame.friction = friction;
    frame.slopes = (half){friction[0], -friction[0], friction[1], -friction[1]};
    for (int i = first; i < first + wp::max(num_axes, 3); ++i)
        for (int k = 0; k < BLOCKS; ++k)
            J[i][k] = 0.0f;
    for_dofs(world, sides_of(world, conid), [&](int dof, axes motion) {
        at(J[first], dof) = motion.x;
        at(J[first + 1], dof) = motion.y;
        at(J[first + 2], dof) = motion.z;
        for (int axis = 3; axis < num_axes; ++axis)
            at(J[first + axis], dof) = ((const float*)&motion)[axis];
        frame.dofs[dof / 64] |= 1ull << dof % 64;
    });
    first += num_axes;
    row += frame.num_rows;
}
// What rows are of a vector, J v.
auto multiply = [&](const lanes* v, lanes* to) __attribute__((noinline)) {
    for (int i = 0; i < num_plain; ++i)
        at(to, i) = dot(J[i], v);
    for (int f = 0; f < num_frames; ++f) {
        const Frame& frame = frames[f];
        const half along = dots(J + frame.first, v);
        *(loose_half*)((float*)to + frame.row) = along.xxxx + frame.slopes * along.yyzz;
        for (int k = 4; k < frame.num_rows; k += 2) {
            const float slope = frame.friction[k / 2] * dot(J[frame.first + k / 2 + 1], v);
            at(to, frame.row + k) = along.x + slope;
            at(to, frame.row + k + 1) = along.x - slope;
        }
    }
};
multiply(x, residual);
const float *stiffness = &wp::index(rows.D, world, 0), *aref = &wp::index(rows.aref, world, 0);
for (int i = 0; i < num_rows; ++i) {
    at(D, i) = stiffness[i];
    at(residual, i) -= aref[i];
}
for (int i = ne + nf; i < num_rows; ++i)
    at(high, i) = 0.0f;
for (int i = ne; i < wp::min(ne + nf, num_rows); ++i) {
    const float limit = wp::index(rows.frictionloss, world, i);
    at(loss, i) = limit;
    at(high, i) = limit / at(D, i);
    at(low, i) = -limit / at(D, i);
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
auto sum_of_edges = [](const Frame& frame, half edges) {
    return frame.num_axes > 1 ? edges.x + edges.y + edges.z + edges.w : edges.x;
};
// The edges of a contact whose weights change, by their frame: J' C J, of which C couples the normal with
// each other axis.
auto add_frame_to_H = [&](const Frame& frame, const float* more) {
    const half edges = *(const loose_half*)more, coupled = frame.slopes * edges;
    const half squares = frame.slopes * coupled;
    float normal = sum_of_edges(frame, edges), to_normal[5] = {}, own[5] = {};
    for (int k = 4; k < frame.num_rows; k += 2) {
        const float slope = frame.friction[k / 2], both = more[k] + more[k + 1];
        normal += both;
        to_normal[k / 2] = slope * (more[k] - more[k + 1]);
        own[k / 2] = slope * slope * both;
    }
    const float first = coupled.x + coupled.y, second = coupled.z + coupled.w;
    const float first_own = squares.x + squares.y, second_own = squares.z + squares.w;
    lanes(*j)[BLOCKS] = J + frame.first;
    for (int word = 0; word < WORDS; ++word) {
        for (unsigned long long dofs = frame.dofs[word]; dofs; dofs &= dofs - 1) {
            const int c = 64 * word + __builtin_ctzll(dofs), blocks = blocks_up_to(c);
            const float x = at(j[0], c), y = at(j[1], c), z = at(j[2], c);
            half factors = {normal * x + first * y + second * z, first * x + first_own * y,
                            second * x + second_own * z, 0.0f};
            for (int k = 2; k < frame.num_axes - 1; ++k) {
                factors.x += to_normal[k] * at(j[k + 1], c);
                add(H[c], to_normal[k] * x + own[k] * at(j[k + 1], c), j[k + 1], blocks);
            }
            add_three(H[c], factors, j, blocks);
        }
    }
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
    numbers flipped = 0;
    for (int b = 0; b < row_blocks; ++b) {
        const lanes r = residual[b];
        const auto below = r <= low[b], above = r >= high[b];
        force[b] = below ? loss[b] : (above ? -loss[b] : -D[b] * r);
        const numbers now = below ? (numbers)LINEARNEG : (above ? (numbers)SATISFIED : (numbers)QUADRATIC);
        flipped |= now ^ state[b];
        state[b] = now;
        const lanes present = below | above ? (lanes)0.0f : D[b];
        heavier[b] = present - weight[b];
        weight[b] = present;
    }
    if (!__builtin_reduce_or(flipped))
        return false;
    for (int i = 0; i < num_plain; ++i)
        if (at(heavier, i) != 0.0f)
            add_row_to_H(i, at(heavier, i));
    for (int f = 0; f < num_frames; ++f) {
        const float* more = (const float*)heavier + frames[f].row;
        bool changed = false;
        for (int k = 0; k < frames[f].num_rows; ++k)
            changed |= more[k] != 0.0f;
        if (changed)
            add_frame_to_H(frames[f], more);
    }
    return true;
};
// pull = J' force, gradient = M x - smooth - pull; returns the gradient's norm.
auto update_gradient = [&]() __attribute__((noinline)) {
    for (int k = 0; k < BLOCKS; ++k)
        pull[k] = 0.0f;
    for (int i = 0; i < num_plain; ++i)
        if (at(force, i) != 0.0f)
            add(pull, at(force, i), J[i]);
    for (int f = 0; f < num_frames; ++f) {
        const Frame& frame = frames[f];
        const float* push = (const float*)force + frame.row;
        const half edges = *(const loose_half*)push, slopes = frame.slopes * edges;
        half along = {sum_of_edges(frame, edges), slopes.x + slopes.y, slopes.z + slopes.w, 0.0f};
        for (int k = 4; k < frame.num_rows; k += 2) {
            along.x += push[k] + push[k + 1];
            add(pull, frame.friction[k / 2] * (push[k] - push[k + 1]), J[frame.first + k / 2 + 1]);
        }
        if (along.x != 0.0f)
            add_three(pull, along, J + frame.first);
    }
    for (int k = 0; k < BLOCKS; ++k)
        gradient[k] = Mx[k] - smooth[k] - pull[k];
    return wp::sqrt(dot(gradient, gradient));
};

// The cost along x + step search, but for a constant. Rows from block `one_sided` on only pull below zero.
struct Cost { double value, slope, curvature; };
double smooth_slope, smooth_curvature;
const int one_sided = (ne + nf + 7) / 8;
auto cost_at = [&](double step) __attribute__((noinline)) {
    wide values = 0.0, slopes = 0.0, curvatures = 0.0;
    for (int b = 0; b < row_blocks; ++b) {
        const wide v = widen(change[b]), d = widen(D[b]), r = widen(residual[b]) + step * v;
        wide pull = 0.0, value = 0.0;
        auto outside = r >= 0.0;
        if (b < one_sided) {
            const wide lowest = widen(low[b]), highest = widen(high[b]), most = widen(loss[b]);
            const auto below = r <= lowest;
            outside = below | (r >= highest);
            pull = below ? most : -most;
            value = most * (below ? 0.5 * lowest - r : r - 0.5 * highest);
        }
        values += outside ? value : 0.5 * d * r * r;
        slopes -= v * (outside ? pull : -d * r);
        curvatures += outside ? (wide)0.0 : v * v * d;
    }
    return Cost{step * (smooth_slope + 0.5 * step * smooth_curvature) + sum(values),
                smooth_slope + step * smooth_curvature + sum(slopes), smooth_curvature + sum(curvatures)};
};
const float tolerance = options.tolerance[world % options.tolerance.shape[0]];
auto below_tolerance = [&](float value) { return !(scale * value >= tolerance); };  // NaN: nothing to gain

// Root of the slope, which rises and is piecewise linear: Newton's method, halving where it leaves the
// bracket. NaN passes through, so that a broken world is seen to be broken.
auto find_step = [&](float& gain) __attribute__((noinline)) {
    const Cost start = cost_at(0.0);
    gain = 0.0f;
    if (start.slope >= 0.0)
        return 0.0;
    const double enough = wp::max(1e-9 * -start.slope, 1e-6 * tolerance / scale);  // above its rounding
    double step = -start.slope / start.curvature, low_step = 0.0, high_step = INF;
    for (int i = 0; i < options.ls_iterations; ++i) {
        const Cost cost = cost_at(step);
        gain = start.value - cost.value;
        if (!(cost.slope > enough || cost.slope < -enough))
            return step;
        (cost.slope < 0.0 ? low_step : high_step) = step;
        const double next = step - cost.slope / cost.curvature;
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
    multiply(search, change);
    wide slopes = 0.0, curvatures = 0.0;
    for (int k = 0; k < BLOCKS; ++k) {
        slopes += widen(search[k]) * (widen(Mx[k]) - widen(smooth[k]));
        curvatures += widen(search[k]) * widen(Ms[k]);
    }
    smooth_slope = sum(slopes);
    smooth_curvature = sum(curvatures);

    // Part: line searches
    float gain;
    const double step = find_step(gain);
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
float* forces = &wp::index(result.force, world, 0);
int* states = &wp::index(result.state, world, 0);
for (int i = 0; i < num_rows; ++i) {
    forces[i] = at(force, i);
    states[i] = ((const int*)state)[i];
}
for (int i = ne; i < wp::min(ne + nf, num_rows); ++i)  // of friction losses, above is not satisfied
    if (states[i] == SATISFIED)
        states[i] = LINEARPOS;
result.niter[world] = iterations;
