// e^x for x <= 88, free of branches, to 1e-7 of it: 2^n e^r with a polynomial on |r| <= 0.35 (Moshier, Cephes,
// expf).
namespace lanes {
template <class V> INLINE V decay(V exponent) {
    const V x = larger(splat<V>(-87.0f), exponent), n = nearest(1.44269504f * x);
    const V r = x - 0.693359375f * n + 2.12194440e-4f * n;
    V p = 1.9875691500e-4f * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    return (p * r * r + r + 1.0f) * power_of_two(whole(n));
}
}  // namespace lanes
