// L' D L = H of the worlds of a block, from the tips of a tree on. H has the pattern of M, whose rows hold
// the dofs above their own and end with it: the beginning of a row is the row of the dof where it stops.
namespace lanes {

// H becomes L, of unit diagonal, and `inverse_pivot` 1 / D.
template <class V, class Rows> void factorize(Rows& inertia, int n, V* H, V* inverse_pivot) {
    const int *begins = inertia.M_rowadr.data, *sizes = inertia.M_rownnz.data;
    for (int i = n - 1; i >= 0; --i) {
        V* tip = H + begins[i];
        const int *above = inertia.M_colind.data + begins[i], last = sizes[i] - 1;
        const V inverse = inverse_pivot[i] = 1.0f / tip[last];
        for (int k = last - 1; k >= 0; --k) {
            const V ratio = tip[k] * inverse;
            V* carrier = H + begins[above[k]];
            for (int j = 0; j <= k; ++j)
                carrier[j] -= ratio * tip[j];
            tip[k] = ratio;
        }
    }
}

// x becomes (L' D L)^-1 x.
template <class V, class Rows>
void substitute(Rows& inertia, int n, const V* L, const V* inverse_pivot, V* x) {
    const int *begins = inertia.M_rowadr.data, *sizes = inertia.M_rownnz.data;
    for (int i = n - 1; i >= 0; --i) {
        const int* above = inertia.M_colind.data + begins[i];
        for (int k = 0; k < sizes[i] - 1; ++k)
            x[above[k]] -= L[begins[i] + k] * x[i];
    }
    for (int i = 0; i < n; ++i) {
        const int* above = inertia.M_colind.data + begins[i];
        V value = x[i] * inverse_pivot[i];
        for (int k = 0; k < sizes[i] - 1; ++k)
            value -= L[begins[i] + k] * x[above[k]];
        x[i] = value;
    }
}
}  // namespace lanes
