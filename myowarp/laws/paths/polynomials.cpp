// Lengths that are polynomials, of a world in each lane (path.py has `polynomial_length`, its oracle).
#ifndef MYOWARP_POLYNOMIALS_CPP
#define MYOWARP_POLYNOMIALS_CPP
namespace lanes {
// The length of a path, and its derivatives by its variables.
template <class Path, class Tables>
INLINE Reals polynomial_length(const Path& path, Tables& tables, const Reals* value, Reals* slopes) {
    const int last = path.variables - 1, *variable = tables.variable.data + path.first_variable;
    Reals length = all(0.0);
    for (int k = 0; k <= last; ++k)
        slopes[k] = all(0.0);
    for (int group = path.first_group; group < path.first_group + path.groups; ++group) {
        const int* power = tables.power.data + group * tables.power.shape[1];
        const int begin = tables.first_coefficient.data[group];
        const Reals& y = value[variable[last]];
        Reals inner = all(0.0), steep = all(0.0), product = all(1.0), by[MOST_VARIABLES];
        for (int c = tables.first_coefficient.data[group + 1] - 1; c >= begin; --c) {
            steep = steep * y + inner;
            inner = inner * y + tables.coefficient.data[c];
        }
        for (int k = 0; k < last; ++k) {
            by[k] = all(0.0);
            if (power[k] == 0)
                continue;
            const Reals& x = value[variable[k]];
            Reals below = all(1.0);
            for (int n = 1; n < power[k]; ++n)
                below = below * x;
            for (int before = 0; before < k; ++before)
                by[before] = by[before] * (below * x);
            by[k] = double(power[k]) * (product * below);
            product = product * (below * x);
        }
        length += product * inner;
        for (int k = 0; k < last; ++k)
            slopes[k] += by[k] * inner;
        slopes[last] += product * steep;
    }
    return length;
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
