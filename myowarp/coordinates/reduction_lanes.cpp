// What acts along the free coordinates of the worlds of a block (reduction.py explains, lanes.cpp says what V
// is). In every world an actuator acts on the same dofs.
namespace lanes {

template <class V, class Followers, class Inertia, class Damping, class Acting, class Moments, class Row,
          class Reduced>
void reduce_block(Block<V>& block, Followers& followers, Inertia& inertia, Damping& damping, Acting& acting,
                  Moments& moments, Row& slopes, Row& excess, Reduced& reduced) {
    const int *coordinate = followers.coordinate.data, number = followers.dof.shape[0];
    const V *M = block.in(acting.M), *speed = block.in(acting.qvel), *arm = block.in(moments.actuator_moment);
    const V *applied = block.in(acting.qfrc_applied), *passive = block.in(acting.qfrc_passive);
    const V *pull = block.in(acting.qfrc_actuator), *bias = block.in(acting.qfrc_bias);
    const V *slope = block.in(slopes), *bend = block.in(excess);
    const Field<V> linear = block.model(damping.dof_damping), more = block.model(damping.dof_dampingpoly);
    auto cleared = [&](auto& array) {
        V* to = block.template out<V>(array);
        for (int k = 0; k < array.shape[1]; ++k)
            to[k] = splat<V>(0.0f);
        return to;
    };
    V *M_r = cleared(reduced.M), *force_r = cleared(reduced.qfrc_applied);
    V *damping_r = cleared(reduced.dof_damping), *arm_r = cleared(reduced.actuator_moment);

    for (int row = 0; row < slopes.shape[1]; ++row) {
        const int p = coordinate[row], first = inertia.M_rowadr.data[row];
        const V s = slope[row], a = bend[row], pace = absolute(speed[row]);
        V force = applied[row] + passive[row] + (pull[row] - bias[row]);
        const V rise = 2.0f * more[2 * row] + 3.0f * pace * more[2 * row + 1];
        damping_r[p] += s * s * (linear[row] + pace * rise);
        for (int k = first; k < first + inertia.M_rownnz.data[row]; ++k) {
            const int column = inertia.M_colind.data[k], o = coordinate[column];
            const int high = p > o ? p : o, low = p > o ? o : p;
            // Below the diagonal of M stands one of two equal entries; on that of M_r both fall.
            const float both = column != row && high == low ? 2.0f : 1.0f;
            M_r[high * (high + 1) / 2 + low] += both * s * slope[column] * M[k];
            force -= M[k] * bend[column];
            if (column != row)
                force_r[o] -= slope[column] * M[k] * a;
        }
        force_r[p] += s * force;
    }
    const int* first = ints_of(moments.moment_rowadr, block.first);
    const int* count = ints_of(moments.moment_rownnz, block.first);
    const int* dofs = ints_of(moments.moment_colind, block.first);
    for (int actuator = 0; actuator < moments.moment_rownnz.shape[1]; ++actuator)
        for (int k = first[actuator]; k < first[actuator] + count[actuator]; ++k)
            arm_r[actuator * number + coordinate[dofs[k]]] += arm[k] * slope[dofs[k]];

    auto store = [&](auto& array, const V* from) { block.store(array, from, 0, array.shape[1]); };
    store(reduced.M, M_r);
    store(reduced.qfrc_applied, force_r);
    store(reduced.dof_damping, damping_r);
    store(reduced.actuator_moment, arm_r);
}
}  // namespace lanes
