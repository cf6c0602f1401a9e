// Newton's method on the dual of a static optimisation with p = 2, a run of frames in each lane
// (dual_newton.py explains, and is what this is tested against). A lane that is done keeps its dual, so that
// its numbers do not depend on those beside it.
namespace lanes {
// A problem of a frame in each lane: entries of A row by row of the unknowns, b, bounds, sizes of rows.
struct DualProblem {
    int count, width, rows;
    const int *row, *begin;
    Reals *x, *right, *low, *high, *soft;

    // A_i . y
    Reals pull(int i, const Reals* y) const {
        Reals s = all(0.0);
        for (int e = i * width; e < (i + 1) * width && row[e] >= 0; ++e)
            s += x[e] * y[row[e]];
        return s;
    }
    Reals bounded(int i, Reals a) const { return smaller(larger(a, low[i]), high[i]); }

    // sum psi(A_i . y) - y . b + e |y|^2 / 2
    Reals cost(const Reals* y) const {
        Reals total = all(0.0);
        for (int i = 0; i < count; ++i) {
            const Reals s = pull(i, y), a = bounded(i, 0.5 * s);
            total += s * a - a * a;
        }
        for (int r = 0; r < rows; ++r)
            total += y[r] * (0.5 * soft[r] * y[r] - right[r]);
        return total;
    }

    // Activations, gradient and second derivatives at y.
    void derive(const Reals* y, Reals* a, Reals* slope, Reals* factor) const {
        for (int r = 0; r < rows; ++r) {
            slope[r] = soft[r] * y[r] - right[r];
            for (int c = begin[r]; c < r; ++c)
                factor[r * rows + c] = all(0.0);
            factor[r * rows + r] = soft[r];
        }
        for (int i = 0; i < count; ++i) {
            const Reals best = 0.5 * pull(i, y);
            a[i] = bounded(i, best);
            const Reals bend = select(a[i] == best, all(0.5), all(0.0));
            for (int e = i * width; e < (i + 1) * width && row[e] >= 0; ++e) {
                const int r = row[e];
                slope[r] += x[e] * a[i];
                const Reals by = x[e] * bend;
                for (int o = i * width; o < (i + 1) * width && row[o] >= 0; ++o)
                    if (row[o] <= r)
                        factor[r * rows + row[o]] += by * x[o];
            }
        }
    }

    // step = -(second derivatives)^-1 slope; the diagonal of the factor holds its inverse.
    void solve(const Reals* slope, Reals* factor, Reals* step) const {
        for (int r = 0; r < rows; ++r) {
            Reals* own = factor + r * rows;
            for (int c = begin[r]; c < r; ++c) {
                const Reals* other = factor + c * rows;
                Reals total = own[c];
                for (int k = begin[r] > begin[c] ? begin[r] : begin[c]; k < c; ++k)
                    total -= own[k] * other[k];
                own[c] = total * other[c];
            }
            Reals total = own[r], rest = -slope[r];
            for (int k = begin[r]; k < r; ++k) {
                total -= own[k] * own[k];
                rest -= own[k] * step[k];
            }
            own[r] = 1.0 / root(larger(total, 0.1 * soft[r]));
            step[r] = rest * own[r];
        }
        for (int r = rows - 1; r >= 0; --r) {
            const Reals* own = factor + r * rows;
            step[r] *= own[r];
            for (int k = begin[r]; k < r; ++k)
                step[k] -= own[k] * step[r];
        }
    }
};

template <class Problem, class Runs, class Rows, class Column>
void optimize_runs(double* memory, Problem& problem, Runs& first, Rows& dual, Rows& activation, Rows& missing,
                   Column& residual) {
    constexpr int N = MYOWARP_LANES;
    const int runs = first.shape[0] - 1;
    DualProblem p;
    p.count = problem.row.shape[0], p.width = problem.row.shape[1], p.rows = problem.right.shape[1];
    p.row = problem.row.data, p.begin = problem.begin.data;
    Scratch scratch(memory);
    auto take = [&](int n) { return scratch.take(n); };
    p.x = take(p.count * p.width), p.low = take(p.count), p.high = take(p.count);
    p.right = take(p.rows), p.soft = take(p.rows);
    Reals *a = take(p.count), *y = take(p.rows), *trial = take(p.rows), *slope = take(p.rows);
    Reals *step = take(p.rows), *size = take(p.rows), *factor = take(p.rows * p.rows);
    const Reals zero = all(0.0), endless = all((double)INFINITY);

    for (int begin = 0; begin < runs; begin += N) {
        Reals largest = endless;
        for (int t = 0;; ++t) {
            int frame[N];
            bool on[N], some = false;
            Reals live;
            for (int lane = 0; lane < N; ++lane) {
                const int run = begin + lane < runs ? begin + lane : runs - 1, end = first.data[run + 1];
                on[lane] = begin + lane < runs && first.data[run] + t < end;
                frame[lane] = on[lane] ? first.data[run] + t : end - 1;
                at(live, lane) = on[lane];
                some |= on[lane];
            }
            if (!some)
                break;
            const Truth met = largest < (double)TOLERANCE;
            for (int r = 0; r < p.rows; ++r) {
                const Reals start = gathered(dual, frame, r);
                y[r] = t ? select(met, y[r], start) : start;
                p.right[r] = gathered(problem.right, frame, r);
                live *= select(p.right[r] - p.right[r] == 0.0, all(1.0), zero);
                size[r] = zero;
            }
            for (int i = 0; i < p.count; ++i) {
                p.low[i] = gathered(problem.lower, frame, i);
                p.high[i] = gathered(problem.upper, frame, i);
                const Reals scale = gathered(problem.scale, frame, i);
                for (int e = i * p.width; e < (i + 1) * p.width && p.row[e] >= 0; ++e) {
                    const int column = problem.entry.data[e];
                    p.x[e] = column < 0 ? scale : scale * gathered(problem.effect, frame, column);
                    live *= select(p.x[e] - p.x[e] == 0.0, all(1.0), zero);
                    size[p.row[e]] += p.x[e] * p.x[e];
                }
            }
            for (int r = 0; r < p.rows; ++r) {
                size[r] = select(size[r] > 0.0, root(size[r]), all(1.0));
                p.soft[r] = (double)SOFTNESS * size[r] * size[r];
            }
            const Truth good = live > 0.0;
            Truth busy = good;
            largest = endless;
            Reals cost = p.cost(y);
            for (int iteration = 0; iteration < STEPS && any(busy); ++iteration) {
                p.derive(y, a, slope, factor);
                Reals most = zero;
                for (int r = 0; r < p.rows; ++r)
                    most = larger(most, absolute(slope[r]) / size[r]);
                largest = select(busy, most, largest);
                busy = busy & opposite(most < (double)TOLERANCE);
                if (!any(busy))
                    break;
                p.solve(slope, factor, step);
                Reals descent = zero, rounding = zero, length = all(1.0);
                for (int r = 0; r < p.rows; ++r) {
                    descent += slope[r] * step[r];
                    rounding += (double)ROUNDING * absolute(y[r] * p.right[r]);
                }
                Truth seeking = busy;
                for (int half = 0; half < HALVINGS && any(seeking); ++half) {
                    for (int r = 0; r < p.rows; ++r)
                        trial[r] = y[r] + length * step[r];
                    const Reals now = p.cost(trial);
                    const Truth found = seeking & (now <= cost + (double)ARMIJO * length * descent + rounding);
                    cost = select(found, now, cost);
                    for (int r = 0; r < p.rows; ++r)
                        y[r] = select(found, trial[r], y[r]);
                    seeking = seeking & opposite(found);
                    length *= 0.5;
                }
                busy = busy & opposite(seeking);
            }
            for (int r = 0; r < p.rows; ++r)
                slope[r] = p.right[r];
            for (int i = 0; i < p.count; ++i) {
                a[i] = select(good, a[i], p.low[i]);
                scatter(activation, frame, on, i, a[i]);
                for (int e = i * p.width; e < (i + 1) * p.width && p.row[e] >= 0; ++e)
                    slope[p.row[e]] -= select(good, p.x[e] * a[i], zero);
            }
            for (int r = 0; r < p.rows; ++r) {
                scatter(missing, frame, on, r, slope[r]);
                scatter(dual, frame, on, r, y[r]);
            }
            for (int lane = 0; lane < N; ++lane)
                if (on[lane])
                    residual.data[frame[lane]] = at(largest, lane);
        }
    }
}
}  // namespace lanes
