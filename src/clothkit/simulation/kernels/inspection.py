"""Measurements on a state at rest, in double precision, over all pairs: pierced triangles and the smallest gap."""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change.
import warp as wp


@wp.func
def orientation(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, d: wp.vec3d):
    """Return six times the signed volume of a tetrahedron."""
    return wp.dot(wp.cross(b - a, c - a), d - a)


@wp.func
def pierces(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Return whether the segment p-q passes through the triangle's inside."""
    zero = wp.float64(0.0)
    if orientation(a, b, c, p) * orientation(a, b, c, q) >= zero:
        return False
    ab = orientation(p, q, a, b)
    bc = orientation(p, q, b, c)
    ca = orientation(p, q, c, a)
    return (ab > zero and bc > zero and ca > zero) or (ab < zero and bc < zero and ca < zero)


@wp.kernel
def count_intersections(
    vertices: wp.array2d(dtype=wp.vec3),
    edges: wp.array2d(dtype=int),
    triangles: wp.array2d(dtype=int),
    counts: wp.array2d(dtype=int),
):
    """Count, for each [world, edge], the triangles that it pierces, leaving out those that share a vertex with it."""
    w, e = wp.tid()
    i = edges[e, 0]
    j = edges[e, 1]
    p = vertices[w, i]
    q = vertices[w, j]
    low = wp.min(p, q)
    high = wp.max(p, q)
    count = int(0)
    for t in range(triangles.shape[0]):
        ka = triangles[t, 0]
        kb = triangles[t, 1]
        kc = triangles[t, 2]
        a = vertices[w, ka]
        b = vertices[w, kb]
        c = vertices[w, kc]
        if (
            wp.max(a[0], wp.max(b[0], c[0])) >= low[0]
            and wp.min(a[0], wp.min(b[0], c[0])) <= high[0]
            and wp.max(a[1], wp.max(b[1], c[1])) >= low[1]
            and wp.min(a[1], wp.min(b[1], c[1])) <= high[1]
            and wp.max(a[2], wp.max(b[2], c[2])) >= low[2]
            and wp.min(a[2], wp.min(b[2], c[2])) <= high[2]
        ):
            if i != ka and i != kb and i != kc and j != ka and j != kb and j != kc:
                if pierces(wp.vec3d(p), wp.vec3d(q), wp.vec3d(a), wp.vec3d(b), wp.vec3d(c)):
                    count += 1
    counts[w, e] = count


@wp.func
def distance_to_segment(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d):
    """Return the distance from a point to a segment."""
    d = b - a
    t = wp.clamp(wp.dot(p - a, d) / wp.dot(d, d), wp.float64(0.0), wp.float64(1.0))
    return wp.length(p - a - d * t)


@wp.func
def distance_to_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Return the distance from a point to a triangle."""
    normal = wp.normalize(wp.cross(b - a, c - a))
    zero = wp.float64(0.0)
    if (
        wp.dot(wp.cross(b - a, p - a), normal) >= zero
        and wp.dot(wp.cross(c - b, p - b), normal) >= zero
        and wp.dot(wp.cross(a - c, p - c), normal) >= zero
    ):
        return wp.abs(wp.dot(p - a, normal))
    return wp.min(distance_to_segment(p, a, b), wp.min(distance_to_segment(p, b, c), distance_to_segment(p, c, a)))


@wp.func
def within_two(i: int, j: int, columns: int):
    """Return whether a vertex lies in another's two-ring: at most two rows and two columns away."""
    return wp.abs(i / columns - j / columns) <= 2 and wp.abs(i % columns - j % columns) <= 2


@wp.kernel
def measure_gaps(
    vertices: wp.array2d(dtype=wp.vec3),
    triangles: wp.array2d(dtype=int),
    columns: int,
    reach: float,
    gaps: wp.array2d(dtype=float),
):
    """Measure, for each [world, vertex], the distance to the surface outside its two-ring, at most `reach` metres."""
    w, i = wp.tid()
    p = vertices[w, i]
    best = reach
    for t in range(triangles.shape[0]):
        ka = triangles[t, 0]
        kb = triangles[t, 1]
        kc = triangles[t, 2]
        a = vertices[w, ka]
        b = vertices[w, kb]
        c = vertices[w, kc]
        if (
            wp.max(a[0], wp.max(b[0], c[0])) > p[0] - best
            and wp.min(a[0], wp.min(b[0], c[0])) < p[0] + best
            and wp.max(a[1], wp.max(b[1], c[1])) > p[1] - best
            and wp.min(a[1], wp.min(b[1], c[1])) < p[1] + best
            and wp.max(a[2], wp.max(b[2], c[2])) > p[2] - best
            and wp.min(a[2], wp.min(b[2], c[2])) < p[2] + best
        ):
            if not (within_two(i, ka, columns) or within_two(i, kb, columns) or within_two(i, kc, columns)):
                d = float(distance_to_triangle(wp.vec3d(p), wp.vec3d(a), wp.vec3d(b), wp.vec3d(c)))
                best = wp.min(best, d)
    gaps[w, i] = best
