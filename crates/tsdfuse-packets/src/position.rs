//! What a GNSS receiver at the sensor tells: RMC, the recommended minimum of NMEA 0183.

/// What a packet passes on of a GNSS receiver at the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Position {
    /// A place that was not told before (WGS 84).
    Fix {
        /// Nanoseconds on the sensor's clock.
        time_ns: i64,
        /// Degrees, north positive.
        latitude_deg: f64,
        /// Degrees, east positive.
        longitude_deg: f64,
    },
    /// Nothing new.
    Repeated,
    /// New, but no place: the receiver has no fix, there is none, or its sentence is damaged.
    Void,
}

/// A place and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    /// Microseconds in the hour, UTC.
    pub(crate) micros: u32,
    pub(crate) latitude_deg: f64,
    pub(crate) longitude_deg: f64,
}

/// The first RMC sentence of a text that ends with zeros, without its `$` and its line's end; empty if there is none.
pub(crate) fn sentence(text: &[u8]) -> &[u8] {
    let mut lines = text.split(|b| matches!(b, b'\r' | b'\n' | 0));
    let rmc = lines.find_map(|line| {
        let line = line.strip_prefix(b"$")?;
        (line.get(2..6) == Some(b"RMC,")).then_some(line)
    });
    rmc.unwrap_or_default()
}

/// What an RMC sentence tells; `None` if it is damaged, or says that it is not to be used.
pub(crate) fn parse(sentence: &[u8]) -> Option<Place> {
    let (text, checksum) = std::str::from_utf8(sentence).ok()?.rsplit_once('*')?;
    let told = u8::from_str_radix(checksum.get(..2)?, 16).ok()?;
    if text.bytes().fold(0, |sum, byte| sum ^ byte) != told {
        return None;
    }
    let fields: Vec<&str> = text.split(',').collect();
    let &[_, time, "A", latitude, north, longitude, east, ..] = fields.as_slice() else {
        return None;
    };
    // Hours are the hundreds.
    let minutes = Some(sixties(time)? % 100.0).filter(|minutes| *minutes < 60.0)?;
    Some(Place {
        micros: (minutes * 60e6).round() as u32,
        latitude_deg: signed(latitude, north, ["N", "S"], 90.0)?,
        longitude_deg: signed(longitude, east, ["E", "W"], 180.0)?,
    })
}

/// Degrees of `DDDMM.mm`, minutes of `hhmmss.ss`: the last two digits before the point count sixtieths.
fn sixties(text: &str) -> Option<f64> {
    let whole = text.find('.').unwrap_or(text.len());
    let (large, small) = text.split_at_checked(whole.checked_sub(2)?)?;
    let number = |text: &str| -> Option<f64> {
        let is_plain = text.bytes().all(|b| b.is_ascii_digit() || b == b'.');
        text.parse().ok().filter(|_| is_plain)
    };
    let (large, small) = (number(large)?, number(small)?);
    (small < 60.0).then_some(large + small / 60.0)
}

fn signed(text: &str, side: &str, [plus, minus]: [&str; 2], most: f64) -> Option<f64> {
    let degrees = sixties(text).filter(|degrees| *degrees <= most)?;
    match side {
        _ if side == plus => Some(degrees),
        _ if side == minus => Some(-degrees),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Of a real VLP-16 with a receiver.
    const REAL: &str = "GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E";

    /// With the checksum that belongs to it.
    fn told(text: &str) -> Option<Place> {
        let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
        parse(format!("{text}*{sum:02X}").as_bytes())
    }

    #[test]
    fn a_sentence_tells_place_and_time() {
        let place = parse(REAL.as_bytes()).unwrap();
        assert_eq!(place.micros, 18 * 60_000_000 + 2_000_000);
        assert!((place.latitude_deg - (36.0 + 49.747_855_8 / 60.0)).abs() < 1e-12);
        assert!((place.longitude_deg + (2.0 + 24.454_292_8 / 60.0)).abs() < 1e-12);
        let south = told("GNRMC,235959.25,A,0030.0,S,18000,E,,,010100,,").unwrap();
        assert_eq!((south.latitude_deg, south.longitude_deg), (-0.5, 180.0));
        assert_eq!(south.micros, 3_599_250_000);
    }

    #[test]
    fn sentences_are_found_among_others() {
        let line = format!("${REAL}");
        let padded = |text: &str| [text.as_bytes(), &[0; 9]].concat();
        assert_eq!(sentence(&padded(&format!("{line}\r\n"))), REAL.as_bytes());
        assert_eq!(
            sentence(&padded(&format!("$GPGGA,1,2*00\r\n{line}\r\n"))),
            REAL.as_bytes()
        );
        for none in ["", "$GPGGA,1,2*00", "GPRMC,1", "$RMC,"] {
            assert_eq!(sentence(&padded(none)), b"");
        }
    }

    #[test]
    fn what_is_no_place_is_none() {
        assert_eq!(parse(REAL.replace("*2E", "*2F").as_bytes()), None);
        assert_eq!(parse(REAL.replace("*2E", "").as_bytes()), None);
        for bad in [
            "GPRMC,081802.00,V,3649.7,N,00224.4,W",
            "GPRMC,081802.00,A,,,,",
            "GPRMC,081802.00,A,9000.1,N,00224.4,W",
            "GPRMC,081802.00,A,3660.0,N,00224.4,W",
            "GPRMC,081802.00,A,3649.7,N,18000.1,W",
            "GPRMC,081802.00,A,3649.7,E,00224.4,W",
            "GPRMC,081802.00,A,-3649.7,N,00224.4,W",
            "GPRMC,081802.00,A,nan,N,00224.4,W",
            "GPRMC,081802.00,A,é49.7,N,00224.4,W",
            "GPRMC,,A,3649.7,N,00224.4,W",
            "GPRMC,086002.00,A,3649.7,N,00224.4,W",
            "GPRMC,A",
        ] {
            assert_eq!(told(bad), None, "{bad}");
        }
        assert!(told("GPRMC,081802.00,A,3649.7,N,00224.4,W").is_some());
    }

    proptest! {
        #[test]
        fn any_sentence_is_bearable(text in "[0-9.,NSEWA*é+-]{0,60}", bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            for place in [told(&format!("GPRMC,{text}")), parse(sentence(&bytes))].into_iter().flatten() {
                prop_assert!(place.latitude_deg.abs() <= 90.0 && place.longitude_deg.abs() <= 180.0);
                prop_assert!(place.micros <= 3_600_000_000);
            }
        }
    }
}
