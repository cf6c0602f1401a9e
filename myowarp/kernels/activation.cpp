// Activation dynamics; activation.py says what is computed. Free of branches, so that loops over muscles
// become SIMD.

// e^x for x <= 0, to 1e-7 of it: 2^n e^r with a polynomial on |r| <= 0.35 (Moshier, Cephes, expf).
auto decay = [](float x) {
    x = wp::max(x, -87.0f);
    const int n = (int)(1.44269504f * x - 0.5f);
    const float r = x - 0.693359375f * n + 2.12194440e-4f * n;
    float p = 1.9875691500e-4f * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    return (p * r * r + r + 1.0f) * wp::cast<float>((n + 127) << 23);
};

auto activation_rate = [](float excitation, float activation, float tau_act, float tau_deact, float width) {
    const float scale = 0.5f + 1.5f * wp::min(wp::max(activation, 0.0f), 1.0f);
    const float rise = tau_act * scale, fall = tau_deact / scale, difference = excitation - activation;
    const float x = wp::min(wp::max(difference / wp::max(width, 1e-15f) + 0.5f, 0.0f), 1.0f);
    const float hard = difference > 0.0f ? rise : fall;
    const float smooth = fall + (rise - fall) * (x * x * x * (x * (6.0f * x - 15.0f) + 10.0f));
    const float time_constant = width < 1e-15f ? hard : smooth;
    return difference / wp::max(time_constant, 1e-15f);
};

// What is left of `start` after `duration`: c ln(part / start) - (part - start) = -duration, by two steps of
// Halley's method from the rate half way on. They leave 4e-9 after a duration of 2.
auto part_left = [&](float duration, float c, float start) {
    const float half = 0.5f * duration / (c - start);
    float x = -duration / (c - start / (1.0f + half + 0.5f * half * half)), part = 0.0f, step = 0.0f;
    for (int i = 0; i < 2; ++i) {
        part = start * decay(x);
        const float slope = c - part, excess = c * x - part + start + duration;
        step = -excess * slope / (slope * slope + 0.5f * excess * part);
        x += step;
    }
    return part * (1.0f + step + 0.5f * step * step);
};

auto activation_after = [&](float time, float excitation, float activation, float tau_act, float tau_deact) {
    const float c = 0.5f + 1.5f * excitation, gap = excitation - activation;
    const float left = part_left(time / wp::max(tau_act, 1e-15f), c, 1.5f * wp::max(gap, 0.0f));
    const float w = -gap / (c - 1.5f * gap) * decay(-c * time / wp::max(tau_deact, 1e-15f));
    return excitation + (gap > 0.0f ? -left * (1.0f / 1.5f) : c * w / (1.0f - 1.5f * w));
};
