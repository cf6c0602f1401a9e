// Which pairs of geoms of the worlds of a block may touch (contact_filter.py explains the method, lanes.cpp
// what V is).
namespace lanes {

enum { PLANE, SPHERE = 2, CAPSULE, ELLIPSOID, CYLINDER, BOX };  // mjtGeom
constexpr int MAX_STEPS = 10;
constexpr float CONVERGED = 1e-3f, LONGEST_STEP = 0.5f;  // rad; the next error is the square
constexpr float LEAST_CURVATURE = 1e-3f;                 // of the ellipsoid's reach
constexpr float GUARD = 1e-5f;  // of the bodies' size: what rounding may add to a bound

// x -> E x of an ellipsoid, h(n)^2 = n' E n.
template <class V> struct Stretch { V xx, yy, zz, xy, xz, yz; };
template <class V> INLINE Vec3<V> mul(const Stretch<V>& e, Vec3<V> v) {
    return {e.xx * v.x + e.xy * v.y + e.xz * v.z, e.xy * v.x + e.yy * v.y + e.yz * v.z,
            e.xz * v.x + e.yz * v.y + e.zz * v.z};
}
template <class V> INLINE Stretch<V> stretch(const Mat33<V>& R, Vec3<V> size) {
    auto entry = [&](int i, int j) {
        return R.m[i][0] * R.m[j][0] * (size.x * size.x) + R.m[i][1] * R.m[j][1] * (size.y * size.y) +
               R.m[i][2] * R.m[j][2] * (size.z * size.z);
    };
    return {entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)};
}
template <class V> INLINE Vec3<V> unit(Vec3<V> v) {
    return (1.0f / larger(root(dot(v, v)), splat<V>(TINY))) * v;
}
INLINE int rank_of(int kind) { return kind == ELLIPSOID ? CYLINDER : kind == CYLINDER ? ELLIPSOID : kind; }
template <class V> INLINE V clamped(V x, V most) { return larger(-most, smaller(x, most)); }

// A sphere, capsule or cylinder around a segment, an ellipsoid, whose segment is a point, or a box.
template <class V> struct Solid {
    int kind;
    Vec3<V> center;
    V bound, margin;  // with the gap
    Vec3<V> axis;
    V half, radius;
    Stretch<V> e;
    Vec3<V> edges[3];  // halves
    V support(Vec3<V> n) const {
        if (kind == BOX)
            return absolute(dot(n, edges[0])) + absolute(dot(n, edges[1])) + absolute(dot(n, edges[2]));
        if (kind == ELLIPSOID)
            return root(larger(dot(n, mul(e, n)), splat<V>(TINY)));
        const V along = dot(axis, n), edge = half * absolute(along);
        return kind == CYLINDER ? edge + radius * root(larger(1.0f - along * along, splat<V>(0.0f)))
                                : edge + radius;
    }
};

// Newton's step at n of f = level, on the sphere or across an axis; see `newton_step` of separation.py.
template <class V> struct Newton {
    Vec3<V> n, u, v;
    V uu, uv, vv;
    Newton(Vec3<V> n, V level, Vec3<V> axis)
        : n(n), u(unit(cross(axis, n))), v(cross(n, u)), uu(level), uv(splat<V>(0.0f)), vv(level) {}
    void add(const Stretch<V>& e, Vec3<V> s, V inverse) {
        const Vec3<V> eu = mul(e, u), ev = mul(e, v);
        const V us = dot(u, s), vs = dot(v, s);
        uu += inverse * (dot(u, eu) - us * us);
        uv += inverse * (dot(v, eu) - us * vs);
        vv += inverse * (dot(v, ev) - vs * vs);
    }
    template <class M> Vec3<V> step(Vec3<V> gradient, V least, M across) const {
        const V zero = splat<V>(0.0f), twist = select(across, zero, uv), half = 0.5f * (uu - vv);
        const V gu = dot(u, gradient), gv = select(across, zero, dot(v, gradient));
        const V lowest = 0.5f * (uu + vv) - root(half * half + twist * twist);
        const V lift = larger(least - lowest, zero), a = uu + lift, b = vv + lift;
        const V scale = 1.0f / (a * b - twist * twist);
        const Vec3<V> full = (scale * (b * gu - twist * gv)) * u + (scale * (a * gv - twist * gu)) * v;
        const V angle = larger(root(dot(full, full)), splat<V>(TINY));
        return unit(n + smaller(splat<V>(1.0f), LONGEST_STEP / angle) * full);
    }
};

// The mask's worlds in which no n is found with f(n) above the limit; n is the last. `kept`, tried first,
// becomes the n with the largest f(n): going on after a proof makes it one for many steps.
template <class V, class M>
INLINE M not_apart(const Solid<V>& one, const Solid<V>& two, Vec3<V> p, V limit, M mask, Vec3<V>& n,
                   Vec3<V>& kept) {
    const V zero = splat<V>(0.0f), unity = splat<V>(1.0f);
    V reach1, reach2, best = splat<V>(-1e10f);
    auto may_touch = [&](Vec3<V> towards) {
        n = towards;
        reach1 = one.support(n), reach2 = two.support(n);
        const V level = dot(n, p) - reach1 - reach2;
        mask = mask & (level <= limit);
        kept = select(level > best, n, kept);
        best = larger(level, best);
    };
    may_touch(kept);
    if (!any(mask))
        return mask;
    M busy = mask;  // others stay as they are: no world's bits depend on another's
    may_touch(unit(p));
    for (int k = 0; k < (two.kind == BOX ? 3 : 0); ++k)  // across its faces
        may_touch(unit(select(dot(two.edges[k], p) < zero, -unity, unity) * two.edges[k]));
    if (two.kind == BOX)
        return mask;
    if (two.kind != ELLIPSOID) {  // between the closest points of their segments
        const V cosine = dot(one.axis, two.axis), first = dot(one.axis, p), second = dot(two.axis, p);
        const V sine = larger(1.0f - cosine * cosine, splat<V>(1e-6f));
        V s = clamped((first - cosine * second) / sine, one.half);
        const V t = clamped(s * cosine - second, two.half);
        s = clamped(first + t * cosine, one.half);
        may_touch(unit(p + t * two.axis - s * one.axis));
        return mask;
    }
    for (int k = 0; k < MAX_STEPS && any(busy); ++k) {
        const bool both = one.kind == ELLIPSOID;
        const V inverse1 = 1.0f / reach1, inverse2 = 1.0f / reach2;
        const Vec3<V> s2 = inverse2 * mul(two.e, n), rest = p - s2;
        const V along = both ? zero : dot(one.axis, rest);
        const auto side = absolute(along) < one.half;  // its closest point is within the segment
        const Vec3<V> s1 = both ? inverse1 * mul(one.e, n) : clamped(along, one.half) * one.axis;
        const Vec3<V> gradient = rest - s1;
        const auto flat = absolute(n.x) < 0.6f;
        const Vec3<V> other = select(flat, Vec3<V>{unity, zero, zero}, Vec3<V>{zero, unity, zero});
        Newton<V> newton(n, dot(n, gradient), select(side, one.axis, other));
        newton.add(two.e, s2, inverse2);
        if (both)
            newton.add(one.e, s1, inverse1);
        const Vec3<V> next = newton.step(gradient, LEAST_CURVATURE * reach2, side);
        const Vec3<V> change = next - n;
        may_touch(select(busy, select(side, unit(next - dot(one.axis, next) * one.axis), next), n));
        busy = busy & (dot(change, change) > CONVERGED * CONVERGED);
    }
    return mask;
}

template <class V, class Shapes> const Solid<V>* solids_of(Block<V>& block, Shapes& shapes) {
    const int num_geoms = shapes.geom_type.shape[0];
    const Vec3<V>* center = (const Vec3<V>*)block.in(shapes.geom_xpos);
    const Mat33<V>* frame = (const Mat33<V>*)block.in(shapes.geom_xmat);
    const Field<V> size = block.model(shapes.geom_size), bound = block.model(shapes.geom_rbound);
    const Field<V> margin = block.model(shapes.geom_margin), gap = block.model(shapes.geom_gap);
    Solid<V>* solids = (Solid<V>*)block.take(num_geoms * sizeof(Solid<float>) / sizeof(float));
    for (int g = 0; g < num_geoms; ++g) {
        const Vec3<V> extent = size.vec3(g);
        const int kind = shapes.geom_type.data[g];
        Solid<V>& solid = solids[g];
        solid.kind = kind;
        solid.center = center[g];
        solid.axis = {frame[g].m[0][2], frame[g].m[1][2], frame[g].m[2][2]};
        solid.radius = extent.x;
        solid.half = kind == SPHERE || kind == ELLIPSOID ? splat<V>(0.0f) : extent.y;
        solid.bound = bound[g];
        solid.margin = margin[g] + gap[g];
        if (kind == ELLIPSOID)
            solid.e = stretch(frame[g], extent);
        const V sizes[3] = {extent.x, extent.y, extent.z};
        for (int k = 0; k < (kind == BOX ? 3 : 0); ++k)
            solid.edges[k] = sizes[k] * Vec3<V>{frame[g].m[0][k], frame[g].m[1][k], frame[g].m[2][k]};
    }
    return solids;
}

template <class V, class Shapes, class Near> void filter_block(Block<V>& block, Shapes& shapes, Near& near) {
    const int num_pairs = shapes.nxn_geom_pair_filtered.shape[0], *kind = shapes.geom_type.data;
    const Solid<V>* solids = solids_of(block, shapes);
    const Field<V> pair_margin = block.model(shapes.pair_margin), pair_gap = block.model(shapes.pair_gap);
    const V zero = splat<V>(0.0f);
    Vec3<V>* kept = (Vec3<V>*)(aligned(near.kept.data) + 3ll * num_pairs * block.first);
    for (int world = block.first; world < block.first + block.count; ++world)
        near.num.data[world] = 0;
    for (int i = 0; i < num_pairs; ++i) {
        const auto& geoms = shapes.nxn_geom_pair_filtered.data[i];
        const auto& ids = shapes.nxn_pairid_filtered.data[i];
        const bool in_order = rank_of(kind[geoms[0]]) <= rank_of(kind[geoms[1]]);
        const Solid<V>&one = solids[geoms[!in_order]], &two = solids[geoms[in_order]];
        const Vec3<V> p = two.center - one.center;
        const V reach = one.bound + two.bound, touching = ids[0] >= 0 ? pair_margin[ids[0]] + pair_gap[ids[0]]
                                                                      : one.margin + two.margin;
        const V limit = touching + GUARD * (reach + absolute(touching));
        const bool reports = ids[1] >= 0;  // the distance, to a collision sensor
        const auto unbounded = (one.bound == zero) | (two.bound == zero);
        auto mask = reports ? zero == zero : unbounded | (dot(p, p) <= (reach + limit) * (reach + limit));
        if (!any(mask))
            continue;
        Vec3<V> n = p;
        const bool is_solid = two.kind >= SPHERE && two.kind <= BOX;
        if (reports)
            n = unit(p);
        else if (one.kind == PLANE && is_solid)  // it has one n, and may be long
            mask = mask & (dot(one.axis, p) - two.support(one.axis) <= limit + GUARD * root(dot(p, p)));
        else if (one.kind >= SPHERE && is_solid)
            mask = not_apart(one, two, p, limit, mask, n, kept[i]);
        if (!any(mask))
            continue;
        for (int lane = 0; lane < block.count; ++lane) {
            if (!at(mask, lane))
                continue;
            const int world = block.first + lane, place = near.num.data[world]++;
            wp::index(near.pairs, world, place) = i;
            auto& normal = wp::index(near.normals, world, place);
            normal = {in_lane(n.x, lane), in_lane(n.y, lane), in_lane(n.z, lane)};
        }
    }
}
}  // namespace lanes
