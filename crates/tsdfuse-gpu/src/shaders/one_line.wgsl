// Methods with one line per return (`line_of`).

fn fuse_return(i: u32, thread: u32) -> u32 {
    let l = line_of(i);
    if l.outcome == FUSED {
        walk(l);
    }
    return l.outcome;
}
