// Bodies, and muscle paths that touch no wrap object, of a frame in each lane (muscle_paths.py explains, and
// is what this is tested against).
namespace lanes {
typedef Vec3<Reals> Point3;
typedef Mat33<Reals> Axes;

template <class Vector> INLINE Point3 all_of(const Vector& v) { return {all(v[0]), all(v[1]), all(v[2])}; }
// R v and R M of a constant vector and a constant matrix of the model.
template <class Vector> INLINE Point3 times(const Axes& R, const Vector& v) {
    return {R.m[0][0] * v[0] + R.m[0][1] * v[1] + R.m[0][2] * v[2],
            R.m[1][0] * v[0] + R.m[1][1] * v[1] + R.m[1][2] * v[2],
            R.m[2][0] * v[0] + R.m[2][1] * v[1] + R.m[2][2] * v[2]};
}
template <class Matrix> INLINE Axes turned(const Axes& R, const Matrix& M) {
    Axes product;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            product.m[i][j] = R.m[i][0] * M[0][j] + R.m[i][1] * M[1][j] + R.m[i][2] * M[2][j];
    return product;
}
INLINE Point3 transposed_times(const Axes& R, const Point3& v) {
    return {R.m[0][0] * v.x + R.m[1][0] * v.y + R.m[2][0] * v.z,
            R.m[0][1] * v.x + R.m[1][1] * v.y + R.m[2][1] * v.z,
            R.m[0][2] * v.x + R.m[1][2] * v.y + R.m[2][2] * v.z};
}
// R times the rotation about a constant unit axis, I + sin K + (1 - cos) K^2.
template <class Vector> INLINE Axes about(const Axes& R, const Vector& axis, const Reals& angle) {
    Reals sine, cosine;
    sine_cosine(angle, sine, cosine);
    const double K[3][3] = {{0.0, -axis[2], axis[1]}, {axis[2], 0.0, -axis[0]}, {-axis[1], axis[0], 0.0}};
    const Axes RK = turned(R, K), RKK = turned(RK, K);
    const Reals rest = 1.0 - cosine;
    Axes product;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            product.m[i][j] = R.m[i][j] + sine * RK.m[i][j] + rest * RKK.m[i][j];
    return product;
}

struct Bodies {
    Axes* rotation;
    Point3 *origin, *turn, *shift;
};

// `on_curve` of laws/pieces.py: the value of a curve and its slope.
template <class Tables> INLINE void on_curve(Tables& s, int curve, const Reals& x, Reals& value, Reals& slope) {
    const int powers = s.coefficients.shape[1];
    const int first = s.first_piece.data[curve], end = s.first_piece.data[curve + 1];
    int piece[MYOWARP_LANES];
    Reals start;
    for (int lane = 0; lane < MYOWARP_LANES; ++lane) {
        piece[lane] = first;
        while (piece[lane] + 1 < end && s.breaks.data[piece[lane] + 1] <= at(x, lane))
            ++piece[lane];
        at(start, lane) = s.breaks.data[piece[lane]];
    }
    const Reals away = x - start;
    value = all(0.0), slope = all(0.0);
    for (int power = powers - 1; power >= 0; --power) {
        Reals coefficient = all(s.coefficients.data[first * powers + power]);
        if (end - first > 1)
            for (int lane = 0; lane < MYOWARP_LANES; ++lane)
                at(coefficient, lane) = s.coefficients.data[piece[lane] * powers + power];
        slope = slope * away + value;
        value = value * away + coefficient;
    }
}

// `evaluated` of laws/pieces.py: what curves one after the other make of x, and its slope.
template <class Tables> INLINE void evaluated(Tables& s, int number, Reals& value, Reals& slope) {
    slope = all(1.0);
    for (int curve = s.first_curve.data[number]; curve < s.first_curve.data[number + 1]; ++curve) {
        Reals outer, outer_slope, inside = value;
        on_curve(s, curve, value, outer, outer_slope);
        slope = outer_slope * slope;
        bool beyond = false;
        for (int lane = 0; lane < MYOWARP_LANES; ++lane) {
            const double x = at(value, lane), low = s.held.data[curve][0], high = s.held.data[curve][1];
            at(inside, lane) = x < low ? low : (x > high ? high : x);
            beyond = beyond || at(inside, lane) != x;
        }
        if (beyond)
            on_curve(s, curve, inside, outer, outer_slope);
        value = outer;
    }
}

template <class Skeleton> void place_bodies(Skeleton& s, const Reals* q, Bodies& to) {
    for (int body = 0; body < s.parent.shape[0]; ++body) {
        const int parent = s.parent.data[body];
        Axes rotation = {{{all(1.0), all(0.0), all(0.0)}, {all(0.0), all(1.0), all(0.0)},
                          {all(0.0), all(0.0), all(1.0)}}};
        Point3 origin = {all(0.0), all(0.0), all(0.0)};
        if (parent >= 0) {
            rotation = to.rotation[parent];
            origin = to.origin[parent];
        }
        origin = origin + times(rotation, s.frame_origin.data[body]);
        rotation = turned(rotation, s.frame_rotation.data[body].data);
        for (int move = s.first.data[body]; move < s.first.data[body + 1]; ++move) {
            const int free = s.free.data[move];
            Reals value = free >= 0 ? q[free] : all(0.0), slope;
            evaluated(s.functions, move, value, slope);
            const Point3 direction = times(rotation, s.axis.data[move]);
            if (s.kind.data[move] == HINGE) {
                to.turn[move] = slope * direction;
                to.shift[move] = slope * cross(origin, direction);
                if (free >= 0 || at(value, 0) != 0.0)
                    rotation = about(rotation, s.axis.data[move], value);
            } else {
                to.turn[move] = {all(0.0), all(0.0), all(0.0)};
                to.shift[move] = slope * direction;
                origin = origin + value * direction;
            }
        }
        to.origin[body] = origin + times(rotation, s.back_origin.data[body]);
        to.rotation[body] = turned(rotation, s.back_rotation.data[body].data);
    }
}

// What a path does in all lanes; see `follow_paths` and `project_paths`.
template <class Skeleton, class Needed, class Tables, class Fixed> struct Straight {
    Skeleton& skeleton;
    Needed& needed;
    Tables& tables;
    Fixed& fixed;
    Bodies bodies;
    Reals *value, *slope, *arm;  // that points depend on, its slope; moment arms about all coordinates
    Point3 *location, *force, *torque, *along;
    Truth* active;

    void place_point(int number, int slot) {
        const auto& point = tables.points.data[number];
        const int body = fixed.body.data[point.body];
        Point3 local = all_of(point.location);
        active[slot] = all(0.0) == 0.0;
        if (point.condition >= 0)
            active[slot] = (value[point.condition] >= point.low) & (value[point.condition] <= point.high);
        if (point.moving >= 0) {
            const auto& moving = tables.moving.data[point.moving];
            Point3 at = all_of(moving.rest);
            at.x = moving.value[0] >= 0 ? value[moving.value[0]] : at.x;
            at.y = moving.value[1] >= 0 ? value[moving.value[1]] : at.y;
            at.z = moving.value[2] >= 0 ? value[moving.value[2]] : at.z;
            const auto& R = moving.rotation.data;
            local.x += R[0][0] * at.x + R[0][1] * at.y + R[0][2] * at.z;
            local.y += R[1][0] * at.x + R[1][1] * at.y + R[1][2] * at.z;
            local.z += R[2][0] * at.x + R[2][1] * at.y + R[2][2] * at.z;
            along[slot] = {all(0.0), all(0.0), all(0.0)};
        }
        location[slot] = body < 0 ? local : bodies.origin[body] + mul(bodies.rotation[body], local);
    }

    // Along the axes of a moving point.
    void pull_moving(int number, int slot, const Point3& u) {
        const auto& point = tables.points.data[number];
        if (point.moving < 0)
            return;
        const int body = fixed.body.data[point.body];
        const Point3 own = body < 0 ? u : transposed_times(bodies.rotation[body], u);
        const auto& R = tables.moving.data[point.moving].rotation.data;
        along[slot].x += R[0][0] * own.x + R[1][0] * own.y + R[2][0] * own.z;
        along[slot].y += R[0][1] * own.x + R[1][1] * own.y + R[2][1] * own.z;
        along[slot].z += R[0][2] * own.x + R[1][2] * own.y + R[2][2] * own.z;
    }

    // The length, and moment arms.
    void follow(int number, Reals& length) {
        const auto& path = tables.paths.data[number];
        if (path.variables > 0) {
            const int width = fixed.crossed.shape[1], *crossed = fixed.crossed.data + number * width;
            for (int k = 0; k < width && crossed[k] >= 0; ++k)
                arm[crossed[k]] = all(0.0);
            Reals slopes[MOST_VARIABLES];
            length = polynomial_length(path, tables, value, slopes);
            for (int k = 0; k < path.variables; ++k) {
                const int own = tables.variable.data[path.first_variable + k];
                if (needed.free.data[own] >= 0)
                    arm[needed.free.data[own]] -= slopes[k] * slope[own];
            }
            return;
        }
        const Point3 none = {all(0.0), all(0.0), all(0.0)};
        for (int handle = 0; handle < path.handles; ++handle)
            force[handle] = torque[handle] = none;
        for (int slot = 0; slot < path.points; ++slot)
            place_point(path.first_point + slot, slot);
        length = all(0.0);
        for (int far = 1; far < path.points; ++far) {
            const auto& end = tables.points.data[path.first_point + far];
            Truth open = active[far];
            for (int near = far - 1; near >= 0; --near) {
                const auto& start = tables.points.data[path.first_point + near];
                const Truth piece = open & active[near];
                const Point3 way = location[far] - location[near];
                const Reals size = root(dot(way, way));
                length += select(piece, size, all(0.0));
                const int one = start.handle - path.first_handle, other = end.handle - path.first_handle;
                if (one != other) {
                    const Point3 u = select(piece & (size > 0.0), all(1.0) / size, all(0.0)) * way;
                    force[one] = force[one] - u;
                    torque[one] = torque[one] - cross(location[near], u);
                    force[other] = force[other] + u;
                    torque[other] = torque[other] + cross(location[far], u);
                    pull_moving(path.first_point + near, near, none - u);
                    pull_moving(path.first_point + far, far, u);
                }
                if (start.condition < 0)
                    break;
                open = open & opposite(active[near]);
                if (!any(open))
                    break;
            }
        }
        const int width = fixed.crossed.shape[1], *crossed = fixed.crossed.data + number * width;
        for (int k = 0; k < width && crossed[k] >= 0; ++k)
            arm[crossed[k]] = all(0.0);
        for (int handle = 0; handle < path.handles; ++handle) {
            int body = fixed.handle_body.data[path.first_handle + handle];
            for (; body != fixed.stop.data[number]; body = skeleton.parent.data[body])
                for (int move = skeleton.first.data[body]; move < skeleton.first.data[body + 1]; ++move)
                    if (skeleton.free.data[move] >= 0)
                        arm[skeleton.free.data[move]] -= dot(bodies.shift[move], force[handle]) +
                                                         dot(bodies.turn[move], torque[handle]);
        }
        for (int slot = 0; slot < path.points; ++slot) {
            const int moving = tables.points.data[path.first_point + slot].moving;
            if (moving < 0)
                continue;
            const Reals pull[3] = {along[slot].x, along[slot].y, along[slot].z};
            for (int axis = 0; axis < 3; ++axis) {
                const int own = tables.moving.data[moving].value[axis];
                if (own >= 0 && needed.free.data[own] >= 0)
                    arm[needed.free.data[own]] -= pull[axis] * slope[own];
            }
        }
    }
};

template <class Skeleton, class Needed, class Tables, class Fixed, class Rows, class Arms>
void follow_straight(double* memory, Skeleton& skeleton, Needed& needed, Tables& tables, Fixed& fixed,
                     Rows& values, Rows& speeds, Rows& lengths, Rows& velocities, Arms& arms) {
    constexpr int N = MYOWARP_LANES;
    const int bodies = skeleton.parent.shape[0], moves = skeleton.kind.shape[0], free = values.shape[1];
    const int depends = needed.free.shape[0], paths = tables.paths.shape[0], width = fixed.crossed.shape[1];
    int points = 1, handles = 1;
    for (int path = 0; path < paths; ++path) {
        points = tables.paths.data[path].points > points ? tables.paths.data[path].points : points;
        handles = tables.paths.data[path].handles > handles ? tables.paths.data[path].handles : handles;
    }
    Scratch scratch(memory);
    Reals *q = scratch.take(free), *u = scratch.take(free);
    auto vectors = [&](int n) { return (Point3*)scratch.take(3 * n); };
    Straight<Skeleton, Needed, Tables, Fixed> follower = {
        skeleton, needed, tables, fixed,
        {(Axes*)scratch.take(9 * bodies), vectors(bodies), vectors(moves), vectors(moves)},
        scratch.take(depends), scratch.take(depends), scratch.take(free),
        vectors(points), vectors(handles), vectors(handles), vectors(points), (Truth*)scratch.take(points)};

    for (int begin = 0; begin < values.shape[0]; begin += N) {
        int frame[N];
        bool on[N];
        for (int lane = 0; lane < N; ++lane) {
            on[lane] = begin + lane < values.shape[0];
            frame[lane] = on[lane] ? begin + lane : values.shape[0] - 1;
        }
        for (int k = 0; k < free; ++k) {
            q[k] = gathered(values, frame, k);
            u[k] = gathered(speeds, frame, k);
        }
        if (fixed.body.shape[0] > 0)
            place_bodies(skeleton, q, follower.bodies);
        for (int k = 0; k < depends; ++k) {
            const int own = needed.free.data[k];
            follower.value[k] = own >= 0 ? q[own] : all(0.0);
            evaluated(needed.functions, k, follower.value[k], follower.slope[k]);
        }
        for (int path = 0; path < paths; ++path) {
            const int column = fixed.column.data[path], *crossed = fixed.crossed.data + path * width;
            Reals length, velocity = all(0.0);
            follower.follow(path, length);
            scatter(lengths, frame, on, column, length);
            for (int k = 0; k < width && crossed[k] >= 0; ++k) {
                const int coordinate = crossed[k];
                velocity -= follower.arm[coordinate] * u[coordinate];
                scatter(arms, frame, on, column * free + coordinate, follower.arm[coordinate]);
            }
            scatter(velocities, frame, on, column, velocity);
        }
    }
}
}  // namespace lanes
