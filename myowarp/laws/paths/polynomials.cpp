// Lengths that are polynomials, of a world in each lane (path.py has `polynomial_length`, its oracle).
#ifndef MYOWARP_POLYNOMIALS_CPP
#define MYOWARP_POLYNOMIALS_CPP
namespace lanes {
// The length of a path, and its derivatives by its variables, by Horner's rule in one variable within another:
// groups of terms come with the powers of the first variables falling. Level k gathers what x_0 to x_(k-1) are
// still to multiply.
template <class Path, class Tables>
INLINE Reals polynomial_length(const Path& path, Tables& tables, const Reals* value, Reals* slopes) {
    const int last = path.variables - 1, *variable = tables.variable.data + path.first_variable;
    const int width = tables.power.shape[1], end = path.first_group + path.groups;
    Reals sum[MOST_VARIABLES], by[MOST_VARIABLES][MOST_VARIABLES];
    for (int level = 0; level <= last; ++level) {
        sum[level] = all(0.0);
        for (int k = level; k <= last; ++k)
            by[level][k] = all(0.0);
    }
    auto raise = [&](int level, int times) {
        const Reals& x = value[variable[level]];
        for (int n = 0; n < times; ++n) {
            by[level][level] = by[level][level] * x + sum[level];
            for (int k = level + 1; k <= last; ++k)
                by[level][k] = by[level][k] * x;
            sum[level] = sum[level] * x;
        }
    };
    const Reals& y = value[variable[last]];
    for (int group = path.first_group; group < end; ++group) {
        const int* power = tables.power.data + group * width;
        const int begin = tables.first_coefficient.data[group];
        for (int c = tables.first_coefficient.data[group + 1] - 1; c >= begin; --c) {
            by[last][last] = by[last][last] * y + sum[last];
            sum[last] = sum[last] * y + tables.coefficient.data[c];
        }
        int same = 0;  // variables whose powers the next group has, too
        if (group + 1 < end)
            while (power[same] == power[width + same])
                ++same;
        for (int level = last; level > same; --level) {
            if (level < last)
                raise(level, power[level]);
            sum[level - 1] += sum[level];
            sum[level] = all(0.0);
            for (int k = level; k <= last; ++k) {
                by[level - 1][k] += by[level][k];
                by[level][k] = all(0.0);
            }
        }
        if (same < last)
            raise(same, power[same] - (group + 1 < end ? power[width + same] : 0));
    }
    for (int k = 0; k <= last; ++k)
        slopes[k] = by[0][k];
    return sum[0];
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
