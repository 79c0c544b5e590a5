//! Images in messages: encoded ones as they are, raw ones as PNG.

use super::value::Value;

/// The encoded bytes of a `sensor_msgs/CompressedImage`, or those of a `sensor_msgs/Image` as PNG.
pub(crate) fn encoded(message: &Value<'_>) -> Result<Vec<u8>, String> {
    match message.int("width") {
        Ok(_) => raw(message),
        Err(_) => message.bytes("data").map(<[u8]>::to_vec),
    }
}

fn raw(message: &Value<'_>) -> Result<Vec<u8>, String> {
    let size = |name: &str| {
        message
            .int(name)
            .and_then(|v| u32::try_from(v).map_err(|_| format!("{name} is negative")))
    };
    let (width, height, step) = (size("width")?, size("height")?, size("step")? as usize);
    let (bytes, encoding) = (message.bytes("data")?, message.text("encoding")?);
    // Channels in the message, of them in the picture, and whether red and blue are exchanged.
    let (channels, kept, turned) = match encoding.as_str() {
        "mono8" | "8UC1" => (1, 1, false),
        "rgb8" => (3, 3, false),
        "bgr8" | "8UC3" => (3, 3, true),
        "rgba8" => (4, 3, false),
        "bgra8" | "8UC4" => (4, 3, true),
        other => return Err(format!("images of encoding {other:?} are not read")),
    };
    let row = (width as usize).checked_mul(channels).filter(|&row| row <= step);
    let wanted = step.checked_mul(height as usize);
    let (Some(row), Some(_)) = (row, wanted.filter(|&wanted| wanted <= bytes.len() && wanted > 0)) else {
        return Err(format!(
            "{width} x {height} pixels in rows of {step} bytes are more than its {} bytes",
            bytes.len()
        ));
    };
    let mut pixels = Vec::with_capacity(width as usize * height as usize * kept);
    for row in bytes
        .chunks_exact(step)
        .take(height as usize)
        .filter_map(|bytes| bytes.get(..row))
    {
        for pixel in row.chunks_exact(channels) {
            let from = pixel.len();
            pixels.extend((0..kept).filter_map(|c| pixel.get(if turned { kept - 1 - c } else { c }.min(from))));
        }
    }
    let mut encoded = Vec::new();
    let mut encoder = png::Encoder::new(&mut encoded, width, height);
    encoder.set_color(if kept == 1 {
        png::ColorType::Grayscale
    } else {
        png::ColorType::Rgb
    });
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(&pixels).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(encoded)
}
