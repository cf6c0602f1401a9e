// Muscle curves; curves.py says what they mean. Free of branches, so that loops over muscles become SIMD.

auto quadratic_force_length = [](float length, float lmin, float lmax) {
    const float x = wp::abs(1.0f - length) / (length < 1.0f ? 1.0f - lmin : lmax - 1.0f);
    const float rest = wp::max(1.0f - x, 0.0f);
    return x < 0.5f ? 1.0f - 2.0f * x * x : 2.0f * rest * rest;
};
auto quadratic_force_velocity = [](float velocity, float fvmax) {
    const float saturation = fvmax - 1.0f, rise = wp::max(velocity + 1.0f, 0.0f);
    const float rest = wp::max(saturation - velocity, 0.0f);
    return velocity <= 0.0f ? rise * rise : fvmax - rest * (rest / wp::max(saturation, 1e-15f));
};
auto quadratic_force_velocity_slope = [](float velocity, float fvmax) {
    const float saturation = fvmax - 1.0f, rise = wp::max(velocity + 1.0f, 0.0f);
    const float rest = wp::max(saturation - velocity, 0.0f);
    return 2.0f * (velocity <= 0.0f ? rise : rest / wp::max(saturation, 1e-15f));
};
auto quadratic_passive_force = [](float length, float lmax, float fpmax) {
    const float x = 2.0f * wp::max(length - 1.0f, 0.0f) / wp::max(lmax - 1.0f, 1e-15f);
    return fpmax * (x <= 1.0f ? 0.5f * x * x : x - 0.5f);
};
