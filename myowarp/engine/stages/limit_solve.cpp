// Constraint forces of the worlds of a block in which every row is a limit of one dof, and each of another
// (contact_solve.py explains the method, lanes.cpp what V is). H = M + D has the pattern of M.
namespace lanes {

enum { SATISFIED, QUADRATIC };  // mjtConstraintState

// The only dof in a row of J, -1 if there are none or several; `value` is what stands there.
template <class Rows> INLINE int lone_dof(Rows& rows, int world, int row, int n, float& value) {
    const bool sparse = rows.J_rownnz.shape[1] > 0;
    const int first = sparse ? ints_of(rows.J_rowadr, world)[row] : 0;
    const int size = sparse ? ints_of(rows.J_rownnz, world)[row] : n;
    const int begin = sparse ? first : row * (rows.J.strides[1] / (int)sizeof(float));
    const float* J = row_of(rows.J, world) + begin;
    int found = 0, place = 0;
    for (int k = 0; k < size; ++k) {
        const int here = J[k] != 0.0f;
        found += here;
        place += here * k;
    }
    if (found != 1)
        return -1;
    value = J[place];
    return sparse ? ints_of(rows.J_colind, world)[first + place] : place;
}

// A dof's row, -1 if there is none, and the row's entry of J.
struct Limit { int row; float J; };

// Whether a world is one of those, and its limits.
template <class Counts, class Rows>
bool has_limits_only(Counts& counts, Rows& rows, int world, int n, Limit* limits) {
    const int most = rows.aref.shape[1], found = counts.nefc.data[world];
    if (counts.nl.data[world] < found)
        return false;
    for (int dof = 0; dof < n; ++dof)
        limits[dof] = {-1, 0.0f};
    for (int i = (found < most ? found : most) - 1; i >= 0; --i) {
        float value;
        const int dof = lone_dof(rows, world, i, n, value);
        if (dof < 0 || limits[dof].row >= 0)
            return false;
        limits[dof] = {i, value};
    }
    return true;
}

// Newton's method on H = M + D in the worlds of a block; each pointer is to a value of every dof.
template <class V, class Inertia> struct LimitNewton {
    typedef decltype(widen(V())) W;
    typedef typename MaskOf<V>::type Truth;
    typedef decltype(W() < W()) WideTruth;

    Inertia& inertia;
    const int n, num_entries;
    const int *begins, *sizes, *columns;
    const V *mass, *smooth, *start;
    V *x, *pull, *Mx, *L, *inverse_pivot, *gradient, *search, *Ms, *change, *residual, *force, *weight;
    V *D, *J, *aref;
    const V zero;
    const W none;
    V iterations, scale, tolerance;
    W smooth_slope, smooth_curvature;  // of the cost without rows, along `search`
    Truth unfinished, unbracketed, busy;

    template <class Options, class Row, class Result>
    LimitNewton(Block<V>& block, Inertia& inertia, Options& options, Row& M, Row& qfrc_smooth,
                Row& qacc_warmstart, Row& qacc, Row& qfrc_constraint, Result& result)
        : inertia(inertia), n(qacc.shape[1]), num_entries(M.shape[1]), begins(inertia.M_rowadr.data),
          sizes(inertia.M_rownnz.data), columns(inertia.M_colind.data), mass(block.in(M)),
          smooth(block.in(qfrc_smooth)), start(block.in(qacc_warmstart)), x(block.template out<V>(qacc)),
          pull(block.template out<V>(qfrc_constraint)), Mx(block.template out<V>(result.Ma)),
          L(block.take(num_entries)), inverse_pivot(block.take(n)), gradient(block.take(n)),
          search(block.take(n)), Ms(block.take(n)), change(block.take(n)), residual(block.take(n)),
          force(block.take(n)), weight(block.take(n)), D(block.take(n)), J(block.take(n)),
          aref(block.take(n)), zero(splat<V>(0.0f)), none(widen(zero)),
          iterations(zero), tolerance(block.model(options.tolerance)[0]), unfinished(zero != zero),
          unbracketed(unfinished), busy(unfinished) {
        V trace = zero;
        for (int i = 0; i < n; ++i)
            trace += mass[begins[i] + sizes[i] - 1];
        scale = 1.0f / larger(trace, splat<V>(TINY));
    }

    template <class Rows> void fetch(const Block<V>& block, const Limit* limits, Rows& rows) {
        V num_rows = zero;
        for (int i = 0; i < n; ++i)
            D[i] = aref[i] = weight[i] = zero;
        for (int lane = 0; lane < LanesOf<V>::number; ++lane) {
            const int world = block.first + (lane < block.count ? lane : block.count - 1);
            for (int i = 0; i < n; ++i) {
                const Limit limit = limits[world * n + i];
                in_lane(J[i], lane) = limit.J;
                if (limit.row < 0)
                    continue;
                in_lane(num_rows, lane) += 1.0f;
                in_lane(D[i], lane) = row_of(rows.D, world)[limit.row];
                in_lane(aref[i], lane) = row_of(rows.aref, world)[limit.row];
            }
        }
        busy = num_rows > 0.0f;
    }

    void multiply(const V* v, V* to) {  // by M
        for (int i = 0; i < n; ++i) {
            const int begin = begins[i], diagonal = begin + sizes[i] - 1;
            V sum = mass[diagonal] * v[i];
            for (int k = begin; k < diagonal; ++k) {
                sum += mass[k] * v[columns[k]];
                to[columns[k]] += mass[k] * v[i];
            }
            to[i] = sum;
        }
    }

    V dot(const V* a, const V* b) {
        V sum = zero;
        for (int i = 0; i < n; ++i)
            sum += a[i] * b[i];
        return sum;
    }

    Truth below_tolerance(V value) { return (scale * value >= tolerance) == 0; }  // of NaN, too

    // Forces at the present residual, their share of H, and the gradient; returns whose H has changed.
    Truth update() {
        Truth changed = zero != zero;
        for (int i = 0; i < n; ++i) {
            const auto satisfied = residual[i] >= 0.0f;
            const V now = select(satisfied, zero, D[i] * J[i] * J[i]);
            changed = changed | (now != weight[i]);
            weight[i] = now;
            force[i] = select(satisfied, zero, -D[i] * residual[i]);
            pull[i] = J[i] * force[i];
            gradient[i] = Mx[i] - smooth[i] - pull[i];
        }
        return changed;
    }

    void refactorize() {
        for (int k = 0; k < num_entries; ++k)
            L[k] = mass[k];
        for (int i = 0; i < n; ++i)
            L[begins[i] + sizes[i] - 1] += weight[i];
        factorize(inertia, n, L, inverse_pivot);
    }

    V direction() {  // search = -H^-1 gradient; returns gradient' H^-1 gradient
        for (int i = 0; i < n; ++i)
            search[i] = -gradient[i];
        substitute(inertia, n, L, inverse_pivot, search);
        return -dot(gradient, search);
    }

    // The cost along x + step search: its slope and curvature, and how much it falls from step 0.
    void probe(W step, W& slope, W& curvature) {
        slope = smooth_slope + step * smooth_curvature;
        curvature = smooth_curvature;
        for (int i = 0; i < n; ++i) {
            const W v = widen(change[i]), d = widen(D[i]), r = widen(residual[i]) + step * v;
            const auto satisfied = r >= none;
            slope += select(satisfied, none, v * d * r);
            curvature += select(satisfied, none, v * v * d);
        }
    }

    V improvement(W step) {
        W falls = none;
        for (int i = 0; i < n; ++i) {
            const W r = widen(residual[i]), d = 0.5 * widen(D[i]), after = r + step * widen(change[i]);
            falls += select(r >= none, none, d * r * r) - select(after >= none, none, d * after * after);
        }
        return narrow(falls - step * (smooth_slope + 0.5 * step * smooth_curvature));
    }

    W find_step(int most) {
        multiply(search, Ms);
        smooth_slope = smooth_curvature = none;
        for (int i = 0; i < n; ++i) {
            change[i] = J[i] * search[i];
            smooth_slope += widen(search[i]) * (widen(Mx[i]) - widen(smooth[i]));
            smooth_curvature += widen(search[i]) * widen(Ms[i]);
        }
        W slope, curvature, low = none, high = none + 3.4e38;
        probe(none, slope, curvature);
        Truth searching = busy & narrow((slope >= none) == 0);
        const W enough = -1e-9 * slope;
        W step = select(slope >= none, none, -slope / curvature);
        for (int i = 0; i < most && any(searching); ++i) {
            probe(step, slope, curvature);
            const WideTruth steep = (slope > enough) | (slope < -enough), falling = slope < none;
            searching = searching & narrow(steep);
            low = select(falling, step, low);
            high = select(falling, high, step);
            const W next = step - slope / curvature;
            const WideTruth inside = (next > low) & (next < high), going = widen(searching);
            step = select(going, select(inside, next, 0.5 * (low + high)), step);
        }
        unbracketed = unbracketed | searching;
        return step;
    }

    V begin() {  // at the start given; worlds without rows are solved by it
        for (int i = 0; i < n; ++i)
            x[i] = select(busy, start[i], zero);
        multiply(x, Mx);
        for (int i = 0; i < n; ++i)
            residual[i] = J[i] * x[i] - aref[i];
        update();
        refactorize();
        const V decrement = direction();
        for (int i = 0; i < n; ++i) {  // without rows, a Newton step from rest is the solution
            x[i] = select(busy, x[i], search[i]);
            Mx[i] = select(busy, Mx[i], smooth[i]);
        }
        return decrement;
    }

    void go(V moved) {  // finished worlds stay
        for (int i = 0; i < n; ++i) {
            x[i] = select(busy, x[i] + moved * search[i], x[i]);
            Mx[i] = select(busy, Mx[i] + moved * Ms[i], Mx[i]);
            residual[i] = select(busy, residual[i] + moved * change[i], residual[i]);
        }
    }

    void solve(int most_iterations, int most_steps) {
        V decrement = begin(), norm = root(dot(gradient, gradient));
        for (int iteration = 1; any(busy); ++iteration) {
            const W step = find_step(most_steps);
            const V gain = improvement(step);
            go(narrow(step));
            iterations = select(busy, splat<V>((float)iteration), iterations);

            const Truth flipped = update();
            const V present = root(dot(gradient, gradient)), remaining = absolute(narrow(1.0 - step));
            norm = select(flipped, present, norm * remaining);  // along a quadratic cost it only shrinks
            decrement = decrement * remaining * remaining;
            const Truth gained = (gain > 0.0f) & below_tolerance(gain);
            const Truth small = (flipped == 0) & below_tolerance(0.5f * decrement);
            busy = busy & ((narrow(step == none) | gained | small | below_tolerance(norm)) == 0);
            if (!any(busy))
                break;
            if (any(flipped & busy))
                refactorize();
            decrement = direction();
            norm = present;
            busy = busy & ((flipped & below_tolerance(0.5f * decrement)) == 0);
            if (iteration == most_iterations) {
                unfinished = busy;
                break;
            }
        }
    }

    template <class Result> void publish(const Block<V>& block, const Limit* limits, Result& result) {
        for (int lane = 0; lane < block.count; ++lane) {
            const int world = block.first + lane;
            result.niter.data[world] = (int)in_lane(iterations, lane);
            result.overflow.data[world] |= at(unfinished, lane) ? ITERATIONS_OVERFLOW : 0;
            result.overflow.data[world] |= at(unbracketed, lane) ? LINE_SEARCH_OVERFLOW : 0;
            for (int dof = 0; dof < n; ++dof) {
                const int row = limits[world * n + dof].row;
                if (row < 0)
                    continue;
                row_of(result.force, world)[row] = in_lane(force[dof], lane);
                const bool satisfied = in_lane(weight[dof], lane) == 0.0f;
                ((int*)row_of(result.state, world))[row] = satisfied ? SATISFIED : QUADRATIC;
            }
        }
    }
};

template <class V, class Inertia, class Options, class Row, class Rows, class Result>
void solve_limits_block(Block<V>& block, Inertia& inertia, Options& options, Row& M, Row& qfrc_smooth,
                        Row& qacc_warmstart, const Limit* limits, Rows& rows, Row& qacc, Row& qfrc_constraint,
                        Result& result) {
    LimitNewton<V, Inertia> newton(block, inertia, options, M, qfrc_smooth, qacc_warmstart, qacc,
                                   qfrc_constraint, result);
    newton.fetch(block, limits, rows);
    newton.solve(options.iterations, options.ls_iterations);
    block.store(qacc, newton.x, 0, newton.n);
    block.store(qfrc_constraint, newton.pull, 0, newton.n);
    block.store(result.Ma, newton.Mx, 0, newton.n);
    newton.publish(block, limits, result);
}
}  // namespace lanes
