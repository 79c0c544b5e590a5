// Raycasting: the line along the ray of a return.

fn line_of(i: u32) -> Line {
    return line_along(ray_of(i));
}
