// Forces of affine actuators of the worlds of a block (affine_actuators.py; lanes.cpp says what V is).
// In every world an actuator acts on the same dofs.
namespace lanes {

template <class V, class Actuators, class Moments, class Row>
void actuate_block(Block<V>& block, Actuators& actuators, bool clamp_controls, Moments& moments, Row& ctrl,
                   Row& actuator_force, Row& qfrc_actuator) {
    const int num_dofs = qfrc_actuator.shape[1], num_actuators = actuator_force.shape[1];
    const int* first = ints_of(moments.moment_rowadr, block.first);
    const int* count = ints_of(moments.moment_rownnz, block.first);
    const int* dofs = ints_of(moments.moment_colind, block.first);
    const Field<V> control_range = block.model(actuators.actuator_ctrlrange);
    const Field<V> force_range = block.model(actuators.actuator_forcerange);
    const Field<V> gain = block.model(actuators.actuator_gainprm);
    const Field<V> bias = block.model(actuators.actuator_biasprm);
    const V *control = block.in(ctrl), *arm = block.in(moments.actuator_moment);
    const V *length = block.in(moments.actuator_length), *velocity = block.in(moments.actuator_velocity);
    V *force = block.template out<V>(actuator_force), *sum = block.template out<V>(qfrc_actuator);
    auto clamp = [](V x, const Field<V>& range, int i) {
        const V low = range[2 * i], high = range[2 * i + 1];
        x = select(low > x, low, x);
        return select(x < high, x, high);
    };
    for (int dof = 0; dof < num_dofs; ++dof)
        sum[dof] = splat<V>(0.0f);
    for (int i = 0; i < num_actuators; ++i) {
        const bool clamped = clamp_controls && actuators.actuator_ctrllimited.data[i];
        const V u = clamped ? clamp(control[i], control_range, i) : control[i];
        V f = gain[10 * i] * u + bias[10 * i] + bias[10 * i + 1] * length[i] + bias[10 * i + 2] * velocity[i];
        if (actuators.actuator_forcelimited.data[i])
            f = clamp(f, force_range, i);
        force[i] = f;
        for (int entry = first[i]; entry < first[i] + count[i]; ++entry)
            sum[dofs[entry]] += arm[entry] * f;
    }
    block.store(actuator_force, force, 0, num_actuators);
    block.store(qfrc_actuator, sum, 0, num_dofs);
}
}  // namespace lanes
