// Raycasting: the line along the ray of a return.

fn line_of(i: u32) -> Line {
    let ray = ray_of(i);
    if ray.outcome != FUSED {
        return no_line(ray.outcome);
    }
    return line(ray.end, ray.direction, min(1.0 / ray.range_m, 1.0)); // (5.8)
}
