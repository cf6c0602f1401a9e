// Body of the native function `map_action` (action.py), after decay.cpp. Free of branches, so that the loop
// becomes SIMD.

constexpr float LARGEST = 3.4028235e38f;  // finite number
const auto* range = &wp::index(actuator_ctrlrange, worldid % actuator_ctrlrange.shape[0], 0);
const int* kind = actuator_kind.data;
const float* from = &wp::index(action, worldid, 0);
float* to = &wp::index(ctrl, worldid, 0);
bool finite = true;
for (int i = 0; i < action.shape[1]; ++i) {
    const bool valid = wp::abs(from[i]) <= LARGEST;  // which NaN is not
    finite = finite && valid;
    const float a = valid ? wp::min(wp::max(from[i], -1.0f), 1.0f) : 0.0f;
    const float x = STEEPNESS * (a - CENTER), part = lanes::decay(-wp::abs(x));
    const float excitation = (x > 0.0f ? 1.0f : part) / (1.0f + part);
    const float motor = 0.5f * (range[i][0] + range[i][1]) + 0.5f * (range[i][1] - range[i][0]) * a;
    to[i] = kind[i] == MUSCLE ? excitation : motor;
}
return finite;
