// Lengths that are polynomials, of a world in each lane (path.py has `polynomial_length`, its oracle).
#ifndef MYOWARP_POLYNOMIALS_CPP
#define MYOWARP_POLYNOMIALS_CPP
namespace lanes {
// A polynomial of x_LEVEL to x_LAST, and its derivatives by these.
template <int LEVEL, int LAST> struct Part {
    Reals sum, by[LAST - LEVEL + 1];
};

// The sum of the groups from `group` on with the same powers of x_0 to x_(LEVEL - 1), left out here, by
// Horner's rule in one variable within another. Groups come with falling powers.
template <int LEVEL, int LAST, class Tables>
INLINE Part<LEVEL, LAST> part_from(Tables& tables, const Reals* x, int& group, int end) {
    Part<LEVEL, LAST> found;
    found.sum = all(0.0);
    for (int k = 0; k <= LAST - LEVEL; ++k)
        found.by[k] = all(0.0);
    if constexpr (LEVEL == LAST) {
        const double* first = tables.coefficient.data + tables.first_coefficient.data[group++];
        const double* c = tables.coefficient.data + tables.first_coefficient.data[group];
        while (c-- > first) {
            found.by[0] = found.by[0] * x[LAST] + found.sum;
            found.sum = found.sum * x[LAST] + *c;
        }
    } else {
        const int width = tables.power.shape[1], *begin = tables.power.data + group * width;
        int power = begin[LEVEL];
        for (bool more = true; more;) {
            const Part<LEVEL + 1, LAST> inner = part_from<LEVEL + 1, LAST>(tables, x, group, end);
            found.sum += inner.sum;
            for (int k = 0; k < LAST - LEVEL; ++k)
                found.by[k + 1] += inner.by[k];
            const int* next = tables.power.data + group * width;
            more = group < end;
            for (int k = 0; k < LEVEL; ++k)
                more = more && next[k] == begin[k];
            for (const int lower = more ? next[LEVEL] : 0; power > lower; --power) {
                found.by[0] = found.by[0] * x[LEVEL] + found.sum;
                for (int k = 1; k <= LAST - LEVEL; ++k)
                    found.by[k] = found.by[k] * x[LEVEL];
                found.sum = found.sum * x[LEVEL];
            }
        }
    }
    return found;
}

template <int LAST, class Path, class Tables>
INLINE Reals polynomial_of(const Path& path, Tables& tables, const Reals* value, Reals* slopes) {
    Reals x[LAST + 1];
    for (int k = 0; k <= LAST; ++k)
        x[k] = value[tables.variable.data[path.first_variable + k]];
    int group = path.first_group;
    const Part<0, LAST> found = part_from<0, LAST>(tables, x, group, path.first_group + path.groups);
    for (int k = 0; k <= LAST; ++k)
        slopes[k] = found.by[k];
    return found.sum;
}

// The length of a path, and its derivatives by its variables.
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
