//! The machine that times were taken on.

use serde::{Deserialize, Serialize};

/// Where times were taken.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Machine {
    /// The processor's name, where the system tells.
    pub processor: Option<String>,
    /// The vector instructions that are used.
    pub simd: String,
    /// Threads that worked.
    pub threads: usize,
    /// The operating system.
    pub system: String,
    /// Year, month and day, UTC.
    pub date: String,
}

impl Machine {
    /// This one, today.
    pub fn here(threads: usize) -> Self {
        let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let name = cpu.lines().find_map(|line| line.strip_prefix("model name"));
        let secs = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        Self {
            processor: name.map(|name| name.trim_start_matches([' ', '\t', ':']).to_owned()),
            simd: simd(),
            threads,
            system: std::env::consts::OS.to_owned(),
            date: secs.map_or(String::new(), |since| date(since.as_secs() / 86_400)),
        }
    }
}

/// The most memory this process has held so far, where the system tells (Linux).
pub fn peak_memory_bytes() -> Option<u64> {
    own_status("VmHWM:")
}

/// The processors' time that this process has taken so far, of all threads, seconds; where the system tells (Unix).
pub fn cpu_secs() -> Option<f64> {
    #[cfg(unix)]
    return Some(
        std::time::Duration::try_from(rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime))
            .ok()?
            .as_secs_f64(),
    );
    #[cfg(not(unix))]
    None
}

/// The memory this process holds now, where the system tells (Linux).
#[cfg(feature = "live")]
pub(crate) fn memory_bytes() -> Option<u64> {
    own_status("VmRSS:")
}

fn own_status(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// The vector instructions that this program uses here.
fn simd() -> String {
    let level = format!("{:?}", fearless_simd::Level::new());
    let name = level.split(['(', ' ']).next();
    name.unwrap_or_default().to_uppercase()
}

/// Year, month and day, so many days after 1970-01-01 (Hinnant, "chrono-Compatible Low-Level Date Algorithms").
fn date(days: u64) -> String {
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn linux_tells_the_peak_memory() {
        assert!(peak_memory_bytes().unwrap() > 1 << 20);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn linux_tells_the_time_that_processors_worked() {
        let before = cpu_secs().unwrap();
        let begun = std::time::Instant::now();
        let mut value = 1_u64;
        while cpu_secs().unwrap() < before + 0.05 {
            value = std::hint::black_box(value.wrapping_mul(3));
            assert!(begun.elapsed().as_secs() < 60);
        }
    }

    #[test]
    fn days_are_dates() {
        for (days, wanted) in [
            (0, "1970-01-01"),
            (59, "1970-03-01"),
            (11_016, "2000-02-29"),
            (19_782, "2024-02-29"),
            (20_513, "2026-03-01"),
        ] {
            assert_eq!(date(days), wanted);
        }
    }
}
