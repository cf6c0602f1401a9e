// Worlds side by side in threads of a GPU: the sources that serve lanes compute with V = Strided, a world in
// each thread. A pointer to it steps over the floats of its neighbours, so that threads that read or write
// the same of their worlds do so in one line of memory; in registers it is a float.
namespace lanes {

constexpr int STRIDE = 32;  // threads of a warp

struct Strided {
    float x, others[STRIDE - 1];
    __attribute__((always_inline)) Strided() {}
    __attribute__((always_inline)) Strided(float x) : x(x) {}
    __attribute__((always_inline)) Strided(const Strided& v) : x(v.x) {}
    __attribute__((always_inline)) Strided& operator=(const Strided& v) { x = v.x; return *this; }
    __attribute__((always_inline)) Strided& operator+=(const Strided& v) { x += v.x; return *this; }
    __attribute__((always_inline)) Strided& operator-=(const Strided& v) { x -= v.x; return *this; }
    __attribute__((always_inline)) Strided& operator*=(const Strided& v) { x *= v.x; return *this; }
};
template <> struct LanesOf<Strided> { static constexpr int number = 1; };
INLINE Strided operator-(const Strided& a) { return -a.x; }
INLINE Strided operator+(const Strided& a, const Strided& b) { return a.x + b.x; }
INLINE Strided operator-(const Strided& a, const Strided& b) { return a.x - b.x; }
INLINE Strided operator*(const Strided& a, const Strided& b) { return a.x * b.x; }
INLINE Strided operator/(const Strided& a, const Strided& b) { return a.x / b.x; }
INLINE bool operator<(const Strided& a, const Strided& b) { return a.x < b.x; }
INLINE bool operator>(const Strided& a, const Strided& b) { return a.x > b.x; }
INLINE bool operator<=(const Strided& a, const Strided& b) { return a.x <= b.x; }
INLINE bool operator>=(const Strided& a, const Strided& b) { return a.x >= b.x; }
INLINE bool operator==(const Strided& a, const Strided& b) { return a.x == b.x; }
INLINE bool operator!=(const Strided& a, const Strided& b) { return a.x != b.x; }
INLINE Strided select(bool mask, const Strided& yes, const Strided& no) { return mask ? yes.x : no.x; }
INLINE Strided root(const Strided& a) { return root(a.x); }
INLINE Strided absolute(const Strided& a) { return absolute(a.x); }
INLINE Strided nearest(const Strided& a) { return nearest(a.x); }
INLINE Strided flipped(const Strided& a, int n) { return flipped(a.x, n); }
INLINE int whole(const Strided& a) { return whole(a.x); }
INLINE double widen(const Strided& a) { return a.x; }

// Never inlined: there are a hundred places, and code has to fit into a cache.
static __attribute__((noinline)) void gather(Strided* to, const float* from, int n) {
    for (int k = 0; k < n; ++k)
        to[k] = from[k];
}
static __attribute__((noinline)) void scatter(float* to, const Strided* from, int n) {
    for (int k = 0; k < n; ++k)
        to[k] = from[k].x;
}

// Worlds of a warp share a part of the memory: so many times STRIDE floats.
template <> struct Block<Strided> : Gathering<Strided, Block<Strided>> {
    Block(int world, float* memory, int floats, Held* held)
        : Gathering(world, 1, (Strided*)(memory + (long long)(world / STRIDE) * STRIDE * floats + world % STRIDE),
                    held) {}
    template <class A> void load(A& array, Strided* to, int begin, int end) {
        gather(to + begin, row_of(array, first % array.shape[0]) + begin, end - begin);
    }
    template <class A> void store(A& array, const Strided* from, int begin, int end) {
        scatter(row_of(array, first) + begin, from + begin, end - begin);
    }
};
}  // namespace lanes
