//! The device against the CPU. Without any adapter these tests say so and pass, unless `TSDFUSE_REQUIRE_GPU` is set; Mesa's
//! lavapipe is one (`./setup.sh` installs it).

#![allow(clippy::unwrap_used)] // tests

#[path = "../../../tsdfuse/tests/common/mod.rs"]
mod common;
mod compare;
mod fusing;
mod map;
mod meshing;
mod patch;
mod rendering;

use std::sync::OnceLock;

use tsdfuse_gpu::Gpu;

/// The device; `None` where there is none and none is required.
fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let open = || match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("TSDFUSE_REQUIRE_GPU").is_none(), "{error}");
            eprintln!("skipped: {error}");
            None
        }
    };
    GPU.get_or_init(open).as_ref()
}

#[test]
fn an_adapter_that_is_not_there_is_named_in_one_sentence() {
    let told = Gpu::open(Some("no such adapter")).unwrap_err().to_string();
    assert!(
        told.starts_with("no GPU can be used: ") && !told.contains('\n'),
        "{told}"
    );
    if let Some(gpu) = gpu() {
        let name = gpu.name();
        assert!(told.contains(name.split(" (").next().unwrap()), "{told}");
        assert!(Gpu::open(name.split(" (").next()).is_ok());
    }
}

/// Opens a device in a process without `XDG_RUNTIME_DIR`; returns what it prints to stderr.
fn stderr_of_child(variable: Option<(&str, &str)>) -> String {
    let mut child = std::process::Command::new(std::env::current_exe().unwrap());
    child.args([
        "--exact",
        "an_adapter_that_is_not_there_is_named_in_one_sentence",
        "--nocapture",
    ]);
    child
        .env_remove("XDG_RUNTIME_DIR")
        .env_remove("NODEVICE_SELECT")
        .envs(variable);
    let run = child.output().unwrap();
    assert!(run.status.success());
    String::from_utf8(run.stderr).unwrap()
}

#[test]
fn a_device_opens_without_a_word_from_mesa() {
    let message = "error: XDG_RUNTIME_DIR";
    let quiet = Some(("NODEVICE_SELECT", "1"));
    assert!(!stderr_of_child(quiet).contains(message));
    // Other drivers never print it.
    eprintln!(
        "without the variable it is printed: {}",
        stderr_of_child(None).contains(message)
    );
    let needed = std::env::var_os("XDG_RUNTIME_DIR").is_none() && std::env::var_os("NODEVICE_SELECT").is_none();
    if needed && cfg!(target_os = "linux") && std::env::var_os("MESA_VK_DEVICE_SELECT").is_none() {
        assert_eq!(tsdfuse_gpu::quiet_variable(), quiet);
    } else if std::env::var_os("XDG_RUNTIME_DIR").is_some_and(|folder| !folder.is_empty()) {
        assert_eq!(tsdfuse_gpu::quiet_variable(), None);
    }
}
