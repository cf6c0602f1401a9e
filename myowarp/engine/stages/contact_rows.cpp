// Body of the native function `write_jacobians` (contact_rows.py, which explains the method).
const bool sparse = rows.J_rownnz.shape[1] > 0;
const int num_contacts = wp::min(contacts.nacon.data[0], contacts.dist.shape[0]);
auto last_dof = [&](int body) {
    const int moved = tree.body_weldid.data[body];
    return wp::max(-1, tree.body_dofadr.data[moved] + tree.body_dofnum.data[moved] - 1);
};
for (int conid = 0; conid < num_contacts; ++conid) {
    const int first = wp::index(contacts.efc_address, conid, 0);
    if (first < 0)
        continue;
    const int world = contacts.worldid.data[conid], condim = contacts.dim.data[conid];
    const int num_rows = wp::min(wp::max(1, 2 * (condim - 1)), rows.aref.shape[1] - first);
    const wp::mat33 frame = contacts.frame.data[conid];
    const float* friction = (const float*)&contacts.friction.data[conid];
    // Of an edge of the pyramid: what a motion has along normal and tangents, and about them.
    auto edge = [&](const float* motion, int row) {
        const float slope = condim == 1 ? 0.0f : friction[row / 2] * motion[row / 2 + 1];
        return row % 2 ? motion[0] - slope : motion[0] + slope;
    };
    wp::vec3 arms[2];
    int dofs[2];
    for (int k = 0; k < 2; ++k) {
        const int body = tree.geom_bodyid.data[contacts.geom.data[conid][k]];
        arms[k] = contacts.pos.data[conid] - wp::index(subtree_com, world, tree.body_rootid.data[body]);
        dofs[k] = last_dof(body);
    }
    const int begin = sparse ? wp::index(rows.J_rowadr, world, first) : 0;
    const int stride = sparse ? wp::index(rows.J_rownnz, world, first) : rows.J.strides[1] / (int)sizeof(float);
    float* J = &wp::index(rows.J, world, sparse ? 0 : first, begin);
    for (int i = 0; !sparse && i < num_rows * stride; ++i)
        J[i] = 0.0f;
    float velocity[6] = {};
    for (int column = 0; dofs[0] != dofs[1]; ++column) {  // what moves both moves neither against the other
        const int dof = wp::max(dofs[0], dofs[1]), body = dof == dofs[1], place = sparse ? column : dof;
        const float *moved = (const float*)&wp::index(cdof, world, dof), sign = body ? 1.0f : -1.0f;
        const wp::vec3 angular(moved[0], moved[1], moved[2]), linear(moved[3], moved[4], moved[5]);
        const wp::vec3 at_point = linear + wp::cross(angular, arms[body]);
        float motion[6];
        for (int k = 0; k < 3; ++k) {
            const wp::vec3 direction = frame.get_row(k);
            motion[k] = sign * wp::dot(direction, at_point);
            motion[k + 3] = sign * wp::dot(direction, angular);
        }
        for (int k = 0; k < 6; ++k)
            velocity[k] += wp::index(qvel, world, dof) * motion[k];
        for (int row = 0; row < num_rows; ++row) {
            J[row * stride + place] = edge(motion, row);
            if (sparse)
                wp::index(rows.J_colind, world, 0, begin + row * stride + place) = dof;
        }
        dofs[body] = tree.dof_parentid.data[dof];
    }
    for (int row = 0; row < num_rows; ++row)
        wp::index(rows.vel, world, first + row) = edge(velocity, row);
}
