//! Pages with a surface, in a real browser.

use tsdfuse::Pose;
use tsdfuse::glam::{DMat3, DQuat, DVec3};
use tsdfuse::render::{Camera, RenderConfig, Renderer};
use tsdfuse::sensor::Pinhole;

use crate::browser::{Browser, Shot, chromium};
use crate::run::{Folder, tsdfuse};

const SIZE: [usize; 2] = [800, 600];

/// A simulated street as a page and as a map.
fn street(folder: &Folder, voxel_size_m: f64) -> [String; 2] {
    let log = folder.simulate("log", "street", "vlp16", 6, &[]);
    let (page, map) = (folder.text("street.html"), folder.text("street.tsdf"));
    tsdfuse(&[
        "fuse",
        &log,
        "-o",
        &page,
        "--save-map",
        &map,
        "--voxel-size",
        &voxel_size_m.to_string(),
        "--truncation",
        "0.6",
    ])
    .succeeded();
    [page, map]
}

/// Looks in the page from `eye` (world) at `at`.
fn look(browser: &mut Browser, eye: DVec3, at: DVec3) {
    let local = |place: DVec3| format!("[{} - o[0], {} - o[1], {} - o[2]]", place.x, place.y, place.z);
    let origin = "const o = JSON.parse(document.getElementById('scene').textContent).origin;";
    browser.eval(&format!("{{ {origin} tsdfuse.look({}, {}) }}", local(eye), local(at)));
}

/// Whether a pixel is of the grey surface; what is behind it is hidden first.
fn silhouette(browser: &mut Browser) -> Shot {
    let hide = "tsdfuse.hideSky(); document.body.style.background = '#f0f'; for (const id of ['bar', 'figures', 'scale', 'status']) document.getElementById(id).style.display = 'none';";
    browser.eval(&format!("{{ {hide} }}"));
    browser.shot()
}

fn is_surface(pixel: [u8; 3]) -> bool {
    pixel[1] > 25
}

/// The share of pixels that agree on whether there is surface.
fn agreement(shot: &Shot, seen: &[bool]) -> f64 {
    assert_eq!(shot.pixels.len(), seen.len());
    let same = shot
        .pixels
        .iter()
        .zip(seen)
        .filter(|(pixel, seen)| is_surface(**pixel) == **seen);
    same.count() as f64 / seen.len() as f64
}

#[test]
fn a_page_shows_what_the_renderer_sees_and_asks_nobody() {
    let Some(chromium) = chromium() else { return };
    let folder = Folder::new();
    let [page, map] = street(&folder, 0.2);
    let mut browser = Browser::open(&chromium, &format!("file://{page}"), SIZE);
    browser.eval("tsdfuse.setMode('shaded')");
    browser.key("KeyP"); // the path is no surface
    let map = tsdfuse_io::map_file::read(map).unwrap();
    let renderer = Renderer::new(&map, &RenderConfig::default()).unwrap();
    let bounds = {
        let mesh = tsdfuse::mesh::extract(&map).unwrap();
        mesh.vertices
            .iter()
            .fold((DVec3::MAX, DVec3::MIN), |(low, high), v| (low.min(*v), high.max(*v)))
    };
    let center = (bounds.0 + bounds.1) / 2.0;
    for (eye, at) in [
        (center + DVec3::new(-30.0, -25.0, 30.0), center),
        (center + DVec3::new(5.0, 2.0, 25.0), center + DVec3::new(6.0, 0.0, 0.0)),
    ] {
        look(&mut browser, eye, at);
        let shot = silhouette(&mut browser);
        let x = (at - eye).normalize();
        let y = DVec3::Z.cross(x).normalize();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y)));
        // The page's field of view is that of its height.
        let half = (60f64.to_radians() / 2.0).tan() * SIZE[0] as f64 / SIZE[1] as f64;
        let pinhole = Pinhole::with_fov(SIZE[0] as u32, SIZE[1] as u32, (2.0 * half.atan()) as f32);
        let view = renderer
            .view(
                &Camera::Pinhole(pinhole),
                Pose {
                    rotation,
                    translation: eye,
                },
            )
            .unwrap();
        // The renderer sees surface only from the side that was measured.
        let seen: Vec<bool> = view.hits.iter().map(Option::is_some).collect();
        let agree = agreement(&shot, &seen);
        assert!(agree > 0.9, "{agree}");
        let missing = shot
            .pixels
            .iter()
            .zip(&seen)
            .filter(|(pixel, seen)| **seen && !is_surface(**pixel))
            .count();
        assert!(
            (missing as f64) < 0.02 * seen.len() as f64,
            "{missing} pixels show no surface"
        );
        // The comparison tells another view from this one.
        let mut turned = seen.clone();
        turned.reverse();
        assert!(agreement(&shot, &turned) < agree - 0.1);
    }
    assert_eq!(browser.errors, [""; 0]);
    assert!(
        browser
            .requests
            .iter()
            .all(|url| url.starts_with("file://") || url.starts_with("data:") || url.starts_with("blob:")),
        "{:?}",
        browser.requests
    );
}

#[test]
fn keys_and_fingers_move_measure_cut_and_colour() {
    let Some(chromium) = chromium() else { return };
    let folder = Folder::new();
    let [page, _] = street(&folder, 0.2);
    let mut browser = Browser::open(&chromium, &format!("file://{page}"), SIZE);
    let first = browser.state();
    assert!(
        first["triangles"].as_u64().unwrap() > 1000 && first["mode"] == "shaded" && first["path"] == 6,
        "{first}"
    );
    assert!(
        first["figures"].as_array().unwrap().iter().any(|row| row == "scans6"),
        "{first}"
    );
    let plain = browser.shot();

    // Modes: grey, then colours.
    let colors = |shot: &Shot| {
        let vivid = shot
            .pixels
            .iter()
            .filter(|p| p.iter().max().unwrap() - p.iter().min().unwrap() > 120);
        vivid.count()
    };
    browser.key("Digit2");
    assert_eq!(browser.state()["mode"], "height");
    let colored = browser.shot();
    assert!(
        colors(&colored) > 4 * colors(&plain),
        "{} {}",
        colors(&colored),
        colors(&plain)
    );
    browser.key("Digit1");

    // Cutting hides what is higher.
    browser.key("KeyT");
    browser.eval("tsdfuse.setClip(1000)");
    let whole = silhouette(&mut browser);
    browser.eval("tsdfuse.setClip(0)");
    let cut = silhouette(&mut browser);
    let surface = |shot: &Shot| shot.pixels.iter().filter(|p| is_surface(**p)).count();
    assert!(
        surface(&cut) < surface(&whole) / 4,
        "{} {}",
        surface(&cut),
        surface(&whole)
    );
    for _ in 0..40 {
        browser.key("BracketRight");
    }
    assert_eq!(browser.state()["clip"], 1e9);

    // Two clicks measure a distance between the places that the pixels show.
    browser.key("KeyM");
    let state = browser.state();
    let origin = browser.eval("JSON.parse(document.getElementById('scene').textContent).origin");
    let origin = DVec3::from_array(serde_json::from_value(origin).unwrap());
    let [eye, at] = ["eye", "at"].map(|name| DVec3::from_array(serde_json::from_value(state[name].clone()).unwrap()));
    let middle = [SIZE[0] / 2, SIZE[1] / 2];
    // Two points of the surface near the middle.
    let found: Vec<[usize; 2]> = (0..SIZE[0])
        .map(|x| [x, middle[1]])
        .filter(|[x, y]| is_surface(whole.pixels[y * SIZE[0] + x]))
        .collect();
    let (a, b) = (found[found.len() / 4], found[3 * found.len() / 4]);
    let mut ends = Vec::new();
    for pixel in [a, b] {
        browser.click(pixel);
        let told = browser.state()["labels"][0].as_str().unwrap().to_owned();
        let place: Vec<f64> = told.split(", ").map(|number| number.parse().unwrap()).collect();
        let place = DVec3::from_slice(&place);
        // The label's place (world) is seen at the pixel.
        let (ahead, way) = ((at - eye).normalize(), place - origin - eye);
        let right = ahead.cross(DVec3::Z).normalize();
        let focal = 0.5 * SIZE[1] as f64 / 30f64.to_radians().tan();
        let seen = [right, right.cross(ahead)].map(|axis| focal * way.dot(axis) / way.dot(ahead));
        let seen = [0.5 * SIZE[0] as f64 + seen[0], 0.5 * SIZE[1] as f64 - seen[1]];
        let off = [seen[0] - pixel[0] as f64, seen[1] - pixel[1] as f64];
        assert!(
            off[0].abs() < 1.5 && off[1].abs() < 1.5,
            "{told}: {seen:?} instead of {pixel:?}"
        );
        ends.push(place);
        browser.key("Escape");
    }
    browser.click(a);
    browser.click(b);
    let told = browser.state()["labels"][0].as_str().unwrap().to_owned();
    let length: f64 = told.split(" m").next().unwrap().parse().unwrap();
    assert!((length - ends[0].distance(ends[1])).abs() < 0.02, "{told}: {ends:?}");
    browser.key("KeyM");

    // Flying: forward along the view.
    browser.key("KeyH");
    browser.key("KeyF");
    let before = browser.state();
    browser.eval("globalThis.was = tsdfuse.state()");
    browser.hold(
        "KeyW",
        "Math.hypot(...tsdfuse.state().eye.map((x, i) => x - was.eye[i])) > 0.3",
    );
    let after = browser.state();
    let vector =
        |state: &serde_json::Value, name: &str| DVec3::from_array(serde_json::from_value(state[name].clone()).unwrap());
    let moved = vector(&after, "eye") - vector(&before, "eye");
    assert!(
        moved.length() > 0.2 && moved.normalize().dot(vector(&before, "ahead")) > 0.99,
        "{moved}"
    );
    browser.hold(
        "ArrowLeft",
        "tsdfuse.state().ahead.reduce((sum, x, i) => sum + x * was.ahead[i], 0) < 0.98",
    );
    let turned = vector(&browser.state(), "ahead");
    assert!(vector(&after, "ahead").cross(turned).z > 0.05, "{turned}");
    browser.key("Escape");

    // Touch: one finger turns, two come nearer.
    browser.key("KeyH");
    let before = browser.state();
    browser.touch(&[[[300, 300], [420, 330]]]);
    let turned = browser.state();
    let arm = |state: &serde_json::Value| vector(state, "eye") - vector(state, "at");
    assert!(arm(&before).normalize().dot(arm(&turned).normalize()) < 0.98);
    assert!((arm(&before).length() / arm(&turned).length() - 1.0).abs() < 1e-3);
    browser.touch(&[[[380, 300], [250, 300]], [[420, 300], [550, 300]]]);
    let nearer = browser.state();
    assert!(
        arm(&nearer).length() < 0.8 * arm(&turned).length(),
        "{} {}",
        arm(&nearer),
        arm(&turned)
    );
    assert_eq!(browser.errors, [""; 0]);
}

/// What a frame asks of the GPU, counted between the page and WebGL: software that stands for a GPU tells nothing about how smooth it is.
#[test]
fn frames_draw_what_is_in_view_and_upload_nothing() {
    let Some(chromium) = chromium() else { return };
    let folder = Folder::new();
    let [page, _] = street(&folder, 0.07);
    let mut browser = Browser::open(&chromium, &format!("file://{page}"), SIZE);
    // All of it has been in view once.
    browser.eval("tsdfuse.look([0, -400, 300], [0, 0, 0])");
    browser.shot();
    browser.eval(
        "globalThis.calls = {};
        for (const name of ['drawElements', 'bufferData', 'bufferSubData', 'texImage2D', 'texSubImage2D']) {
            const call = WebGL2RenderingContext.prototype[name];
            WebGL2RenderingContext.prototype[name] = function (...all) {
                calls[name] = (calls[name] || 0) + 1;
                return call.apply(this, all);
            };
        }",
    );
    let pieces = browser.state()["meshes"].as_u64().unwrap();
    assert!(pieces > 3, "{pieces}");
    let mut frame = |look: &str| {
        browser.eval(&format!("{{ calls = {{}}; {look} }}"));
        browser.shot();
        browser.eval("calls")
    };
    // One call for each piece, and one for what is drawn over the whole screen.
    let all = frame("tsdfuse.look([0, -300, 300], [0, 0, 0])");
    assert_eq!(all, serde_json::json!({ "drawElements": pieces + 1 }));
    let sky = frame("tsdfuse.look([0, 0, 50], [10, 0, 100])");
    assert_eq!(sky, serde_json::json!({ "drawElements": 1 }));
    let part = frame("tsdfuse.look([0, 0, 2], [1, 0, 2])");
    let drawn = part["drawElements"].as_u64().unwrap();
    assert!(
        part.as_object().unwrap().len() == 1 && (2..=pieces).contains(&drawn),
        "{part}"
    );
    // Nobody moves: nothing is drawn.
    assert_eq!(frame(""), serde_json::json!({}));
    assert_eq!(browser.errors, [""; 0]);
}
