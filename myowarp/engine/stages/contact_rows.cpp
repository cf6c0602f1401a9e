
// Body of the native function `write_jacobians` (contact_rows.py), after contact_frame.cpp.
const bool sparse = rows.J_rownnz.shape[1] > 0;
const int num_contacts = wp::min(contacts.nacon.data[0], contacts.dist.shape[0]);
for (int conid = 0; conid < num_contacts; ++conid) {
    const int first = wp::index(contacts.efc_address, conid, 0);
    if (first < 0)
        continue;
    const int world = contacts.worldid.data[conid], condim = contacts.dim.data[conid];
    const int num_rows = wp::min(wp::max(1, 2 * (condim - 1)), rows.aref.shape[1] - first);
    const float* friction = friction_of(conid);
    const Sides sides = sides_of(world, conid);
    axes velocity = 0.0f;
    for (const Side& side : sides.of)
        velocity += side.along((const float*)&wp::index(cvel, world, side.body));
    for (int row = 0; row < num_rows; ++row)
        wp::index(rows.vel, world, first + row) = edge((const float*)&velocity, friction, row);
    if (in_solver)
        continue;
    const int begin = sparse ? wp::index(rows.J_rowadr, world, first) : 0;
    const int stride =
        sparse ? wp::index(rows.J_rownnz, world, first) : rows.J.strides[1] / (int)sizeof(float);
    float* J = &wp::index(rows.J, world, sparse ? 0 : first, begin);
    for (int i = 0; !sparse && i < num_rows * stride; ++i)
        J[i] = 0.0f;
    int column = 0;
    for_dofs(world, sides, [&](int dof, axes motion) {
        const int place = sparse ? column++ : dof;
        for (int row = 0; row < num_rows; ++row) {
            J[row * stride + place] = edge((const float*)&motion, friction, row);
            if (sparse)
                wp::index(rows.J_colind, world, 0, begin + row * stride + place) = dof;
        }
    });
}
