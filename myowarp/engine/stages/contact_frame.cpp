// How the bodies of a contact move along its axes (contact_rows.py explains the method); `tree`, `contacts`,
// `subtree_com` and `cdof` are the caller's.
typedef float axes __attribute__((ext_vector_type(8)));  // normal, tangents, about the normal, about tangents

// A body, its last dof, and what six components of a motion, (angular, linear), are along the axes.
struct Side {
    int body, dof;
    axes component[6];
    axes along(const float* motion) const {
        return motion[0] * component[0] + motion[1] * component[1] + motion[2] * component[2] +
               motion[3] * component[3] + motion[4] * component[4] + motion[5] * component[5];
    }
};

struct Sides {
    Side of[2];  // what the first does counts as negative
};
auto sides_of = [&](int world, int conid) {
    const wp::mat33 frame = contacts.frame.data[conid];
    axes direction[3], turn[3];
    for (int i = 0; i < 3; ++i) {
        direction[i] = (axes){frame.data[0][i], frame.data[1][i], frame.data[2][i], 0, 0, 0, 0, 0};
        turn[i] = __builtin_shufflevector(direction[i], direction[i], 3, 3, 3, 0, 1, 2, 3, 3);
    }
    Sides sides;
    for (int k = 0; k < 2; ++k) {
        const int body = tree.geom_bodyid.data[contacts.geom.data[conid][k]];
        const int moved = tree.body_weldid.data[body];
        const wp::vec3 center = wp::index(subtree_com, world, tree.body_rootid.data[body]);
        const wp::vec3 arm = (k ? 1.0f : -1.0f) * (contacts.pos.data[conid] - center);
        Side& side = sides.of[k];
        side.body = body;
        side.dof = wp::max(-1, tree.body_dofadr.data[moved] + tree.body_dofnum.data[moved] - 1);
        for (int i = 0; i < 3; ++i) {  // d (v + w x arm) = d v + (arm x d) w
            const int j = (i + 1) % 3, l = (i + 2) % 3;
            side.component[i] = arm[j] * direction[l] - arm[l] * direction[j] + (k ? turn[i] : -turn[i]);
            side.component[3 + i] = k ? direction[i] : -direction[i];
        }
    }
    return sides;
};
// Give `use` each dof that moves the bodies against each other, and its motion along the axes.
auto for_dofs = [&](int world, const Sides& sides, auto use) {
    int first = sides.of[0].dof, second = sides.of[1].dof;
    while (first != second) {  // what moves both moves neither against the other
        const bool is_second = second > first;
        int& dof = is_second ? second : first;
        use(dof, sides.of[is_second].along((const float*)&wp::index(cdof, world, dof)));
        dof = tree.dof_parentid.data[dof];
    }
};
const float no_friction[5] = {};
auto friction_of = [&](int conid) {
    return contacts.dim.data[conid] == 1 ? no_friction : (const float*)&contacts.friction.data[conid];
};
// Of an edge of the pyramid, from what is along the axes.
auto edge = [](const float* along, const float* friction, int row) {
    const float slope = friction[row / 2] * along[row / 2 + 1];
    return row % 2 ? along[0] - slope : along[0] + slope;
};
