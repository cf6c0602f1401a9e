// Lengths that are polynomials, of a world in each lane (path.py has `polynomial_length`, its oracle).
#ifndef MYOWARP_POLYNOMIALS_CPP
#define MYOWARP_POLYNOMIALS_CPP
namespace lanes {
// The length of a path, and its derivatives by its variables, by Horner's rule in one variable within another:
// groups of terms come with the powers of the first variables falling. Level k gathers what x_0 to x_(k-1) are
// still to multiply. The number of variables is LAST + 1.
template <int LAST, class Path, class Tables>
INLINE Reals polynomial_of(const Path& path, Tables& tables, const Reals* value, Reals* slopes) {
    const int* variable = tables.variable.data + path.first_variable;
    const int width = tables.power.shape[1], end = path.first_group + path.groups;
    Reals x[LAST + 1], sum[LAST + 1], by[LAST + 1][LAST + 1];
    for (int level = 0; level <= LAST; ++level) {
        x[level] = value[variable[level]];
        sum[level] = all(0.0);
        for (int k = level; k <= LAST; ++k)
            by[level][k] = all(0.0);
    }
    for (int group = path.first_group; group < end; ++group) {
        const int* power = tables.power.data + group * width;
        const double* first = tables.coefficient.data + tables.first_coefficient.data[group];
        const double* c = tables.coefficient.data + tables.first_coefficient.data[group + 1];
        Reals inner = all(0.0), steep = all(0.0);
        while (c-- > first) {
            steep = steep * x[LAST] + inner;
            inner = inner * x[LAST] + *c;
        }
        sum[LAST] = inner;
        by[LAST][LAST] = steep;
        int same = 0;  // variables whose powers the next group has, too
        if (group + 1 < end)
            while (power[same] == power[width + same])
                ++same;
        for (int level = LAST; level >= same; --level) {
            if (level < LAST) {
                const int to = level == same && group + 1 < end ? power[width + level] : 0;
                for (int n = power[level]; n > to; --n) {
                    by[level][level] = by[level][level] * x[level] + sum[level];
                    for (int k = level + 1; k <= LAST; ++k)
                        by[level][k] = by[level][k] * x[level];
                    sum[level] = sum[level] * x[level];
                }
            }
            if (level == same)
                break;
            sum[level - 1] += sum[level];
            sum[level] = all(0.0);
            for (int k = level; k <= LAST; ++k) {
                by[level - 1][k] += by[level][k];
                by[level][k] = all(0.0);
            }
        }
    }
    for (int k = 0; k <= LAST; ++k)
        slopes[k] = by[0][k];
    return sum[0];
}

template <class Path, class Tables>
INLINE Reals polynomial_length(const Path& path, Tables& tables, const Reals* value, Reals* slopes) {
    switch (path.variables) {
        case 1: return polynomial_of<0>(path, tables, value, slopes);
        case 2: return polynomial_of<1>(path, tables, value, slopes);
        case 3: return polynomial_of<2>(path, tables, value, slopes);
        case 4: return polynomial_of<3>(path, tables, value, slopes);
        case 5: return polynomial_of<4>(path, tables, value, slopes);
        default: return polynomial_of<MOST_VARIABLES - 1>(path, tables, value, slopes);
    }
}

// The polynomials among paths, in all worlds.
template <class Tables, class Numbers, class Values, class Reached>
void follow_polynomials(double* memory, Tables& tables, Numbers& numbers, Values& values, Reached& length,
                        Reached& by_variable) {
    constexpr int N = MYOWARP_LANES;
    Scratch scratch(memory);
    Reals *value = scratch.take(values.shape[1]), slopes[MOST_VARIABLES];
    for (int begin = 0; begin < values.shape[0]; begin += N) {
        int world[N];
        bool on[N];
        for (int lane = 0; lane < N; ++lane) {
            on[lane] = begin + lane < values.shape[0];
            world[lane] = on[lane] ? begin + lane : values.shape[0] - 1;
        }
        for (int k = 0; k < values.shape[1]; ++k)
            value[k] = gathered(values, world, k);
        for (int k = 0; k < numbers.shape[0]; ++k) {
            const auto& path = tables.paths.data[numbers.data[k]];
            scatter(length, world, on, numbers.data[k], polynomial_length(path, tables, value, slopes));
            for (int variable = 0; variable < path.variables; ++variable)
                scatter(by_variable, world, on, path.first_variable + variable, slopes[variable]);
        }
    }
}
}  // namespace lanes
#endif
