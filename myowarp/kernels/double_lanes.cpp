// Lanes in float64 (lanes.cpp has those in float32): `Reals` are a number of each of MYOWARP_LANES worlds.
#ifndef MYOWARP_DOUBLE_LANES_CPP
#define MYOWARP_DOUBLE_LANES_CPP
namespace lanes {
#if MYOWARP_LANES > 1
typedef Doubles Reals;
typedef WideMask Truth;
typedef WideMask Longs;
INLINE bool any(WideMask mask) { return __builtin_reduce_or(mask) != 0; }
INLINE WideMask opposite(WideMask mask) { return ~mask; }
INLINE Doubles root(Doubles x) { return __builtin_elementwise_sqrt(x); }
INLINE Doubles absolute(Doubles x) { return __builtin_elementwise_abs(x); }
INLINE Doubles nearest(Doubles x) { return __builtin_elementwise_roundeven(x); }
INLINE WideMask whole(Doubles x) { return __builtin_convertvector(x, WideMask); }
#else
typedef double Reals;
typedef bool Truth;
typedef long long Longs;
INLINE double root(double x) { return sqrt(x); }
INLINE double absolute(double x) { return fabs(x); }
INLINE double nearest(double x) { return rint(x); }
INLINE long long whole(double x) { return (long long)x; }
#endif
INLINE Reals all(double x) { Reals v; v = x; return v; }
INLINE double& at(Reals& x, int lane) { return ((double*)&x)[lane]; }
INLINE double at(const Reals& x, int lane) { return ((const double*)&x)[lane]; }

// Cody and Waite's reduction to an eighth of a turn, polynomials of Cephes (Moshier).
INLINE void sine_cosine(Reals x, Reals& sine, Reals& cosine) {
    const Reals quarter = nearest(x * 0.63661977236758134308);
    const Reals r = ((x - quarter * 1.57079625129699707031) - quarter * 7.54978941586159635335e-8) -
                    quarter * 5.39030285815811905290e-15;
    const Reals z = r * r;
    const Reals s = r + r * z * (-1.66666666666666307295e-1 + z * (8.33333333332211858878e-3 + z * (
        -1.98412698295895385996e-4 + z * (2.75573136213857245213e-6 + z * (
        -2.50507477628578072866e-8 + z * 1.58962301576546568060e-10)))));
    const Reals c = 1.0 - 0.5 * z + z * z * (4.16666666666665929218e-2 + z * (-1.38888888888730564116e-3 + z * (
        2.48015872888517045348e-5 + z * (-2.75573141792967388112e-7 + z * (
        2.08757008419747316778e-9 + z * -1.13585365213876817300e-11)))));
    const Longs n = whole(quarter);
    const Truth odd = (n & 1) != 0;
    const Reals sine_of = select(odd, c, s), cosine_of = select(odd, s, c);
    sine = select((n & 2) != 0, -sine_of, sine_of);
    cosine = select(((n + 1) & 2) != 0, -cosine_of, cosine_of);
}

// Rows of an array (1 or worlds, n) of float64, the numbers of each lane, and back where a lane is on.
template <class A> INLINE double* numbers_of(A& array, int row) {
    return (double*)((char*)array.data + (long long)(array.shape[0] > 1 ? row : 0) * array.strides[0]);
}
template <class A> INLINE Reals gathered(A& array, const int* row, int k) {
    if (array.shape[0] == 1)
        return all(((double*)array.data)[k]);
    Reals x;
    for (int lane = 0; lane < MYOWARP_LANES; ++lane)
        at(x, lane) = numbers_of(array, row[lane])[k];
    return x;
}
template <class A> INLINE void scatter(A& array, const int* row, const bool* on, int k, const Reals& x) {
    for (int lane = 0; lane < MYOWARP_LANES; ++lane)
        if (on[lane])
            numbers_of(array, row[lane])[k] = at(x, lane);
}

// Scratch memory, where a vector begins at a multiple of its size.
struct Scratch {
    Reals* free;
    Scratch(double* memory)
        : free((Reals*)(((unsigned long long)memory + sizeof(Reals) - 1) & ~(sizeof(Reals) - 1))) {}
    Reals* take(int n) { return (free += n) - n; }
};
}  // namespace lanes
#endif
