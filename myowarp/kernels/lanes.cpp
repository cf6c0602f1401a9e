// Worlds in SIMD lanes: one source computes with V = float, a world at a time, or with V = Lanes, a world in
// each lane. It stands at namespace level (lanes.py says how). Both give the same bits: operations and their
// order are the same, and sine and cosine are polynomials in both.
#ifndef MYOWARP_LANES_CPP
#define MYOWARP_LANES_CPP
#ifdef __clang__
#pragma clang diagnostic ignored "-Wpsabi"  // 512 bits are two registers of AVX2; no such call leaves the file
#endif
#ifdef MYOWARP_LANES  // a flag of the compiler says how many
#elif !defined(__clang__) || defined(__CUDACC__)
#define MYOWARP_LANES 1
#elif !__has_builtin(__builtin_elementwise_sqrt) || !__has_builtin(__builtin_reduce_or)
#define MYOWARP_LANES 1
#elif defined(__AVX512F__)
#define MYOWARP_LANES 16
#elif defined(__AVX__)
#define MYOWARP_LANES 8
#elif defined(__SSE2__) || defined(__ARM_NEON)
#define MYOWARP_LANES 4
#else
#define MYOWARP_LANES 1
#endif
#define INLINE static inline __attribute__((always_inline))
namespace lanes {

template <class V> struct MaskOf { typedef bool type; };
template <class V> struct IntsOf { typedef int type; };
INLINE bool any(bool mask) { return mask; }
INLINE bool opposite(bool mask) { return !mask; }
INLINE float select(bool mask, float yes, float no) { return mask ? yes : no; }
INLINE float root(float x) { return sqrtf(x); }
INLINE float absolute(float x) { return fabsf(x); }
INLINE float nearest(float x) { return rintf(x); }
INLINE int whole(float x) { return (int)x; }
INLINE int bits(float x) { return wp::cast<int>(x); }
INLINE float number(int n) { return (float)n; }
INLINE float from_bits(int n) { return wp::cast<float>(n); }
INLINE float power_of_two(int n) { return wp::cast<float>((n + 127) << 23); }
INLINE float flipped(float x, int n) { return n & 2 ? -x : x; }
INLINE bool at(bool mask, int) { return mask; }
INLINE double widen(float x) { return x; }
INLINE bool widen(bool mask) { return mask; }
INLINE float narrow(double x) { return (float)x; }
INLINE bool narrow(bool mask) { return mask; }
INLINE double select(bool mask, double yes, double no) { return mask ? yes : no; }

#if MYOWARP_LANES > 1
typedef float Lanes __attribute__((ext_vector_type(MYOWARP_LANES)));
typedef int Mask __attribute__((ext_vector_type(MYOWARP_LANES)));
template <> struct MaskOf<Lanes> { typedef Mask type; };
template <> struct IntsOf<Lanes> { typedef Mask type; };
INLINE bool any(Mask mask) { return __builtin_reduce_or(mask) != 0; }
INLINE Mask opposite(Mask mask) { return ~mask; }
INLINE Lanes select(Mask mask, Lanes yes, Lanes no) { return mask ? yes : no; }
INLINE Lanes root(Lanes x) { return __builtin_elementwise_sqrt(x); }
INLINE Lanes absolute(Lanes x) { return (Lanes)((Mask)x & 0x7fffffff); }
INLINE Lanes nearest(Lanes x) { return __builtin_elementwise_roundeven(x); }
INLINE Mask whole(Lanes x) { return __builtin_convertvector(x, Mask); }
INLINE Mask bits(Lanes x) { return (Mask)x; }
INLINE Lanes number(Mask n) { return __builtin_convertvector(n, Lanes); }
INLINE Lanes from_bits(Mask n) { return (Lanes)n; }
INLINE Lanes power_of_two(Mask n) { return (Lanes)((n + 127) << 23); }
INLINE Lanes flipped(Lanes x, Mask n) { return (Lanes)((Mask)x ^ ((n & 2) << 30)); }
INLINE bool at(Mask mask, int lane) { return mask[lane]; }
typedef double Doubles __attribute__((ext_vector_type(MYOWARP_LANES)));
typedef decltype(Doubles() < Doubles()) WideMask;
INLINE Doubles widen(Lanes x) { return __builtin_convertvector(x, Doubles); }
INLINE WideMask widen(Mask mask) { return __builtin_convertvector(mask, WideMask); }
INLINE Lanes narrow(Doubles x) { return __builtin_convertvector(x, Lanes); }
INLINE Mask narrow(WideMask mask) { return __builtin_convertvector(mask, Mask); }
INLINE Doubles select(WideMask mask, Doubles yes, Doubles no) { return mask ? yes : no; }
#endif

constexpr float TINY = 1e-15f;  // mjMINVAL
template <class V> struct LanesOf { static constexpr int number = sizeof(V) / sizeof(float); };
template <class V> INLINE V splat(float x) { V v; v = x; return v; }
template <class V> INLINE float& in_lane(V& v, int lane) { return ((float*)&v)[lane]; }
template <class V> INLINE const float& in_lane(const V& v, int lane) { return ((const float*)&v)[lane]; }
template <class V> INLINE V larger(V a, V b) { return select(a > b, a, b); }
template <class V> INLINE V smaller(V a, V b) { return select(a < b, a, b); }

// Cody and Waite's reduction to an eighth of a turn, polynomials of Cephes (Moshier); to 1 ulp below 1e4 rad.
template <class V> INLINE void sine_cosine(V x, V& sine, V& cosine) {
    const V quarter = nearest(x * 0.636619772f);
    V r = ((x - quarter * 1.5703125f) - quarter * 4.837512969970703e-4f) - quarter * 7.549789948768648e-8f;
    r = select(r > 1.0f, splat<V>(1.0f), select(r < -1.0f, splat<V>(-1.0f), r));  // of x beyond all range
    const V z = r * r;
    const V s = r + r * z * (-1.6666654611e-1f + z * (8.3321608736e-3f + z * -1.9515295891e-4f));
    const V c = 1.0f - 0.5f * z +
                z * z * (4.166664568298827e-2f + z * (-1.388731625493765e-3f + z * 2.443315711809948e-5f));
    const auto n = whole(quarter);
    const auto odd = (n & 1) != 0;
    sine = flipped(select(odd, c, s), n);
    cosine = flipped(select(odd, s, c), n + 1);
}

// The angle of (x, y); polynomial of Cephes on the eighth of a turn nearest to an axis.
template <class V> INLINE V arctan2(V y, V x) {
    const V across = absolute(x), up = absolute(y);
    const V most = larger(across, up), least = smaller(across, up);
    const auto middle = least > 0.414213562f * most;
    const V t = select(middle, least - most, least) / select(middle, least + most, most), z = t * t;
    V angle = t + t * z * (-3.33329491539e-1f +
                           z * (1.99777106478e-1f + z * (-1.38776856032e-1f + z * 8.05374449538e-2f)));
    angle = select(middle, angle + 0.785398163f, angle);
    angle = select(up > across, 1.57079633f - angle, angle);
    angle = select(x < 0.0f, 3.14159265f - angle, angle);
    return select(y < 0.0f, -angle, angle);
}

template <class V> struct Vec3 { V x, y, z; };
template <class V> struct Quat { V w, x, y, z; };
template <class V> struct Mat33 { V m[3][3]; };
template <class V> struct Motion { Vec3<V> angular, linear; };  // or a force

template <class V> INLINE Vec3<V> operator+(Vec3<V> a, Vec3<V> b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class V> INLINE Vec3<V> operator-(Vec3<V> a, Vec3<V> b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class V> INLINE Vec3<V> operator*(V s, Vec3<V> a) { return {s * a.x, s * a.y, s * a.z}; }
template <class V> INLINE V dot(Vec3<V> a, Vec3<V> b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class V> INLINE V dot(const Motion<V>& a, const Motion<V>& b) {
    return dot(a.angular, b.angular) + dot(a.linear, b.linear);
}
template <class V, class M> INLINE Vec3<V> select(M mask, Vec3<V> yes, Vec3<V> no) {
    return {select(mask, yes.x, no.x), select(mask, yes.y, no.y), select(mask, yes.z, no.z)};
}
template <class V> INLINE Vec3<V> cross(Vec3<V> a, Vec3<V> b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class V> INLINE Vec3<V> mul(const Mat33<V>& R, Vec3<V> v) {
    return {R.m[0][0] * v.x + R.m[0][1] * v.y + R.m[0][2] * v.z,
            R.m[1][0] * v.x + R.m[1][1] * v.y + R.m[1][2] * v.z,
            R.m[2][0] * v.x + R.m[2][1] * v.y + R.m[2][2] * v.z};
}
template <class V> INLINE Quat<V> multiply(Quat<V> a, Quat<V> b) {
    return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
template <class V> INLINE Quat<V> normalized(Quat<V> q) {
    const V square = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
    const V scale = select(square > 0.0f, 1.0f / root(square), splat<V>(0.0f));
    return {q.w * scale, q.x * scale, q.y * scale, q.z * scale};
}
template <class V> INLINE Mat33<V> matrix(Quat<V> q) {
    const V ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    const V wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z, xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
    return {{{ww + xx - yy - zz, 2.0f * (xy - wz), 2.0f * (xz + wy)},
             {2.0f * (xy + wz), ww - xx + yy - zz, 2.0f * (yz - wx)},
             {2.0f * (xz - wy), 2.0f * (yz + wx), ww - xx - yy + zz}}};
}
template <class V> INLINE Vec3<V> rotate(Quat<V> q, Vec3<V> v) {
    const Vec3<V> u = {q.x, q.y, q.z};
    return (2.0f * dot(u, v)) * u + (q.w * q.w - dot(u, u)) * v + (2.0f * q.w) * cross(u, v);
}

// A row of an array of the model: of all worlds, or in lanes one of each.
template <class V> struct Field {
    const float* shared;
    const V* each;
    static V of(const Field& f, int i) { return f.each ? f.each[i] : splat<V>(f.shared[i]); }
    V operator[](int i) const { return of(*this, i); }
    Vec3<V> vec3(int i) const { return {of(*this, 3 * i), of(*this, 3 * i + 1), of(*this, 3 * i + 2)}; }
    Quat<V> quat(int i) const {
        return {of(*this, 4 * i), of(*this, 4 * i + 1), of(*this, 4 * i + 2), of(*this, 4 * i + 3)};
    }
    // Whether item i of this size is `first`, and zeros, for all worlds: no world's bits depend on another's.
    bool is(int i, int size, float first) const {
        if (each)
            return false;
        bool same = shared[size * i] == first;
        for (int k = 1; k < size; ++k)
            same = same && shared[size * i + k] == 0.0f;
        return same;
    }
};

template <class A> INLINE float* row_of(A& array, int row) {
    return (float*)((char*)array.data + (long long)row * array.strides[0]);
}
template <class A> INLINE const int* ints_of(A& array, int row) { return (const int*)row_of(array, row); }
template <class A> INLINE int row_floats(A& array) {
    return (array.ndim > 1 ? array.shape[1] : 1) * (int)(sizeof(*array.data) / sizeof(float));
}

// One world: it computes where the engine's arrays are.
template <class V> struct Block {
    int first, count;
    float* scratch;
    V* take(int n) { return (scratch += n) - n; }
    template <class A> const V* in(A& array) { return row_of(array, first); }
    template <class T, class A> T* out(A& array) { return (T*)row_of(array, first); }
    template <class A> Field<V> model(A& array) {
        return {array.shape[0] > 1 ? nullptr : row_of(array, 0),
                array.shape[0] > 1 ? row_of(array, first % array.shape[0]) : nullptr};
    }
    template <class A> void load(A&, V*, int, int) {}
    template <class A> void store(A&, const V*, int, int) {}
};

struct Held { const void* array; int at; };  // what is in a block's memory, and where
constexpr int MOST_HELD = 128;
static __attribute__((noinline)) int find(const Held* held, int num_held, const void* array) {
    int k = num_held - 1;
    while (k >= 0 && held[k].array != array)
        --k;
    return k;
}

// A block that computes in scratch memory, where `load` gathers floats begin, ..., end - 1 of the rows of its
// worlds, and from where `store` writes them. What is there already is not gathered again: a step reads
// what an earlier step of the same launch wrote.
template <class V, class Own> struct Gathering {
    int first, count;
    V *memory, *scratch;
    Held* held;
    int num_held = 0;
    Gathering(int first, int count, V* memory, Held* held)
        : first(first), count(count), memory(memory), scratch(memory), held(held) {}
    V* take(int n) { return (scratch += n) - n; }
    template <class A> const V* in(A& array) {
        const int found = find(held, num_held, array.data);
        if (found >= 0)
            return memory + held[found].at;
        V* to = out<V>(array);
        ((Own*)this)->load(array, to, 0, row_floats(array));
        return to;
    }
    template <class T, class A> T* out(A& array) {
        V* to = take(row_floats(array));
        if (num_held < MOST_HELD)
            held[num_held++] = {array.data, (int)(to - memory)};
        return (T*)to;
    }
    template <class A> Field<V> model(A& array) {
        if (array.shape[0] == 1)
            return {row_of(array, 0), nullptr};
        return {nullptr, in(array)};
    }
};

INLINE void neighbours(const float* from, int begin, float* to) {
    memcpy(to, from + begin, 4 * sizeof(float));
}

#if MYOWARP_LANES > 1
INLINE Lanes interleaved(Lanes a, Lanes b, bool high) {
#if MYOWARP_LANES == 16
    return high ? __builtin_shufflevector(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31)
                : __builtin_shufflevector(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
#elif MYOWARP_LANES == 8
    return high ? __builtin_shufflevector(a, b, 4, 12, 5, 13, 6, 14, 7, 15)
                : __builtin_shufflevector(a, b, 0, 8, 1, 9, 2, 10, 3, 11);
#else
    return high ? __builtin_shufflevector(a, b, 2, 6, 3, 7) : __builtin_shufflevector(a, b, 0, 4, 1, 5);
#endif
}
INLINE void transpose(Lanes* rows) {
    constexpr int N = MYOWARP_LANES;
#pragma unroll
    for (int size = 1; size < N; size *= 2) {
        Lanes next[N];
#pragma unroll
        for (int i = 0; i < N / 2; ++i) {
            next[2 * i] = interleaved(rows[i], rows[i + N / 2], false);
            next[2 * i + 1] = interleaved(rows[i], rows[i + N / 2], true);
        }
#pragma unroll
        for (int i = 0; i < N; ++i)
            rows[i] = next[i];
    }
}
// Four neighbours from where each lane begins, place by place: lanes k, k + 4, ... make up a register, and
// registers are transposed four by four.
#define OF_FOUR(i, q) ((i) % 4 + 4 * (q) + (i) / 4 * MYOWARP_LANES)
#define FOUR(a, b, c, d, q) OF_FOUR(a, q), OF_FOUR(b, q), OF_FOUR(c, q), OF_FOUR(d, q)
#if MYOWARP_LANES == 16
#define IN_FOURS(x, y, a, b, c, d)                                                                           \
    __builtin_shufflevector(x, y, FOUR(a, b, c, d, 0), FOUR(a, b, c, d, 1), FOUR(a, b, c, d, 2),             \
                            FOUR(a, b, c, d, 3))
#elif MYOWARP_LANES == 8
#define IN_FOURS(x, y, a, b, c, d) __builtin_shufflevector(x, y, FOUR(a, b, c, d, 0), FOUR(a, b, c, d, 1))
#else
#define IN_FOURS(x, y, a, b, c, d) __builtin_shufflevector(x, y, FOUR(a, b, c, d, 0))
#endif
INLINE void neighbours(const float* from, Mask begin, Lanes* to) {
    typedef float Four __attribute__((ext_vector_type(4)));
    Lanes rows[4];
    for (int k = 0; k < 4; ++k) {
        Four fours[MYOWARP_LANES / 4];
        for (int q = 0; q < MYOWARP_LANES / 4; ++q)
            memcpy(&fours[q], from + begin[k + 4 * q], sizeof(Four));
#if MYOWARP_LANES == 4
        rows[k] = fours[0];
#else
        const auto low = __builtin_shufflevector(fours[0], fours[1], 0, 1, 2, 3, 4, 5, 6, 7);
#if MYOWARP_LANES == 8
        rows[k] = low;
#else
        const auto high = __builtin_shufflevector(fours[2], fours[3], 0, 1, 2, 3, 4, 5, 6, 7);
        rows[k] = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
#endif
#endif
    }
    for (int half = 0; half < 2; ++half) {
        const Lanes *x = rows, *y = rows + 2;
        const Lanes a = half ? IN_FOURS(x[0], x[1], 2, 6, 3, 7) : IN_FOURS(x[0], x[1], 0, 4, 1, 5);
        const Lanes b = half ? IN_FOURS(y[0], y[1], 2, 6, 3, 7) : IN_FOURS(y[0], y[1], 0, 4, 1, 5);
        to[2 * half] = IN_FOURS(a, b, 0, 1, 4, 5);
        to[2 * half + 1] = IN_FOURS(a, b, 2, 3, 6, 7);
    }
}
// Rows of worlds into lanes, and back for the first `count` of them; never inlined, to compile fast.
static __attribute__((noinline)) void to_lanes(Lanes* to, const float* const* from, int n) {
    constexpr int N = MYOWARP_LANES;
    int k = 0;
    for (; k + N <= n; k += N) {
        Lanes rows[N];
        for (int lane = 0; lane < N; ++lane)
            memcpy(&rows[lane], from[lane] + k, sizeof(Lanes));
        transpose(rows);
        for (int i = 0; i < N; ++i)
            to[k + i] = rows[i];
    }
    for (; k < n; ++k)
        for (int lane = 0; lane < N; ++lane)
            to[k][lane] = from[lane][k];
}
static __attribute__((noinline)) void from_lanes(float* to, int stride, int count, const Lanes* from, int n) {
    constexpr int N = MYOWARP_LANES;
    int k = 0;
    for (; k + N <= n; k += N) {
        Lanes rows[N];
        for (int i = 0; i < N; ++i)
            rows[i] = from[k + i];
        transpose(rows);
        for (int lane = 0; lane < count; ++lane)
            memcpy((char*)(to + k) + (long long)lane * stride, &rows[lane], sizeof(Lanes));
    }
    for (; k < n; ++k)
        for (int lane = 0; lane < count; ++lane)
            *(float*)((char*)(to + k) + (long long)lane * stride) = from[k][lane];
}

// A world in each lane: lanes beyond `count` repeat the last world and are not stored.
template <> struct Block<Lanes> : Gathering<Lanes, Block<Lanes>> {
    Held rows[MOST_HELD];
    Block(int first, int count, float* scratch) : Gathering(first, count, (Lanes*)scratch, rows) {}
    template <class A> void load(A& array, Lanes* to, int begin, int end) {
        const float* from[MYOWARP_LANES];
        for (int lane = 0; lane < MYOWARP_LANES; ++lane)
            from[lane] = row_of(array, (first + (lane < count ? lane : count - 1)) % array.shape[0]) + begin;
        to_lanes(to + begin, from, end - begin);
    }
    template <class A> void store(A& array, const Lanes* from, int begin, int end) {
        from_lanes(row_of(array, first) + begin, array.strides[0], count, from + begin, end - begin);
    }
};
#endif

INLINE float* aligned(float* memory) { return (float*)(((unsigned long long)memory + 63) & ~63ull); }

// Not inlined: with lanes beside it, a world alone would pay for their stack (a quarter of an elbow's step).
template <class B, class Step> static __attribute__((noinline)) void run(B& block, Step& step) {
    step(block);
}

// Call `step` for blocks of worlds in a mask, or of all if it is null. Lanes cost as much as one to two
// worlds alone: fewer go alone.
template <class Step> INLINE void for_blocks(int num_worlds, const bool* mask, float* scratch, Step step) {
    scratch = aligned(scratch);
    for (int world = 0; world < num_worlds;) {
        int count = 0;
        while (count < MYOWARP_LANES && world + count < num_worlds && (!mask || mask[world + count]))
            ++count;
#if MYOWARP_LANES > 1
        if (8 * count > MYOWARP_LANES) {
            Block<Lanes> block{world, count, scratch};
            run(block, step);
            world += count;
            continue;
        }
#endif
        for (int end = world + count; world < end; ++world) {
            Block<float> block{world, 1, scratch};
            run(block, step);
        }
        if (world < num_worlds && mask && !mask[world])
            ++world;
    }
}
}  // namespace lanes
#endif
