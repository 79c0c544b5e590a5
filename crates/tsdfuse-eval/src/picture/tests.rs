use super::*;

const WHITE: [u8; 3] = BACKGROUND;

fn pixel(image: &Image, column: usize, row: usize) -> [u8; 3] {
    match &image.pixels {
        Pixels::Rgb(pixels) => pixels[row * image.width + column],
        Pixels::Grey(pixels) => [pixels[row * image.width + column]; 3],
        _ => unreachable!("coloured"),
    }
}

/// A rectangle across the x axis that faces the origin, `half` metres to each side.
fn board(x: f64, half: f64) -> Mesh {
    Mesh {
        vertices: [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]
            .map(|(y, z)| DVec3::new(x, y * half, z * half))
            .to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    }
}

fn ahead() -> View {
    View::between(Pinhole::with_fov(40, 30, 1.5), DVec3::ZERO, DVec3::X)
}

/// The whole picture, triangle by triangle and pixel by pixel, by rays.
fn literal(view: &View, mesh: &Mesh) -> Vec<bool> {
    let axes = DMat3::from_quat(view.pose.rotation);
    let pixels = (0..30).flat_map(|row| (0..40).map(move |column| (column, row)));
    let seen = |(column, row): (usize, usize)| {
        let ray = axes * view.camera.ray(column as f32, row as f32).as_dvec3();
        mesh.triangles.iter().any(|t| {
            let [a, b, c] = t.map(|v| mesh.vertices[v as usize] - view.pose.translation);
            let sides = [a.cross(b).dot(ray), b.cross(c).dot(ray), c.cross(a).dot(ray)];
            let normal = (b - a).cross(c - a);
            let depth = normal.dot(a) / normal.dot(ray);
            (sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)) && depth >= NEAR_M
        })
    };
    pixels.map(seen).collect()
}

#[test]
fn what_is_drawn_is_what_rays_meet_also_where_triangles_pass_the_camera() {
    let corner = |x, y, z| DVec3::new(x, y, z);
    let floor = Mesh {
        vertices: vec![
            corner(-9.0, -5.3, -1.0),
            corner(30.0, 0.7, -1.1),
            corner(-9.0, 6.1, -0.9),
        ],
        triangles: vec![[0, 1, 2]],
        ..Default::default()
    };
    let mut turned = View::between(
        Pinhole::with_fov(40, 30, 1.5),
        DVec3::new(0.1, 0.2, 0.3),
        corner(3.0, 1.0, -0.7),
    );
    for (view, mesh) in [
        (ahead(), &board(4.0, 2.3)),
        (ahead(), &floor),
        (turned, &board(4.0, 2.3)),
        (turned, &floor),
    ] {
        let image = view.of_mesh(mesh, None);
        let wanted = literal(&view, mesh);
        let drawn: Vec<bool> = (0..1200).map(|i| pixel(&image, i % 40, i / 40) != WHITE).collect();
        let differ = drawn.iter().zip(&wanted).filter(|(a, b)| a != b).count();
        let seen = wanted.iter().filter(|w| **w).count();
        assert!(differ <= 2 && (100..1100).contains(&seen), "{differ} of {seen}");
    }
    turned.pose.translation.y += 0.5;
    let moved = turned.of_mesh(&floor, None);
    turned.pose.translation.y -= 0.5;
    assert_ne!(moved, turned.of_mesh(&floor, None));
}

#[test]
fn the_nearer_surface_is_seen_and_backs_are_almost_black_or_left_out() {
    let (near, far) = (board(2.0, 0.5), board(4.0, 3.0));
    let mut both = far.clone();
    both.vertices.extend(&near.vertices);
    both.triangles.extend(near.triangles.iter().map(|t| t.map(|v| v + 4)));
    let colors: Vec<[u8; 3]> = (0..8).map(|v| if v < 4 { [0, 0, 255] } else { [255, 0, 0] }).collect();
    let image = ahead().of_mesh(&both, Some(&colors));
    let [red, blue] = [pixel(&image, 20, 15), pixel(&image, 8, 15)];
    assert!(
        red[0] > 200 && red[2] == 0 && blue[2] > 150 && blue[0] == 0,
        "{red:?} {blue:?}"
    );

    let mut back = board(2.0, 3.0);
    back.triangles.iter_mut().for_each(|t| t.reverse());
    assert!(pixel(&ahead().of_mesh(&back, None), 20, 15)[0] < 20);
    let culled = View { cull: true, ..ahead() };
    assert_eq!(pixel(&culled.of_mesh(&back, None), 20, 15), WHITE);
    assert_ne!(pixel(&culled.of_mesh(&board(2.0, 3.0), None), 20, 15), WHITE);
}

#[test]
fn points_are_squares_and_those_behind_are_not_seen() {
    let image = ahead().of_points(&[DVec3::new(3.0, 0.0, 0.0), DVec3::new(-3.0, 0.0, 0.0)], 2);
    let drawn = (0..1200).filter(|i| pixel(&image, i % 40, i / 40) != WHITE).count();
    assert!((4..=9).contains(&drawn), "{drawn}");
    assert!(pixel(&image, 20, 15) != WHITE);
}

#[test]
fn a_sheet_holds_each_picture_in_its_place() {
    let image = |shade: u8| Image {
        width: 2,
        height: 1,
        pixels: Pixels::Rgb(vec![[shade; 3], [shade + 1; 3]]),
    };
    let (a, b, c) = (image(10), image(20), image(30));
    let sheet = sheet(&[&a, &b, &c], 2);
    assert_eq!((sheet.width, sheet.height), (4, 2));
    let row = |row: usize| (0..4).map(|column| pixel(&sheet, column, row)[0]).collect::<Vec<_>>();
    assert_eq!((row(0), row(1)), (vec![10, 11, 20, 21], vec![30, 31, 255, 255]));
    assert!(matches!(sheet.pixels, Pixels::Grey(_)));
    let red = Image {
        pixels: Pixels::Rgb(vec![[200, 0, 0]; 2]),
        ..image(0)
    };
    assert_eq!(pixel(&super::sheet(&[&a, &red], 2), 2, 0), [200, 0, 0]);
    assert_eq!(super::sheet(&[], 3).width, 0);
}
