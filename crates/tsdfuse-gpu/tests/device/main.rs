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
