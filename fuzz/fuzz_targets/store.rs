#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = std::env::temp_dir().join(format!("tsdfuse-fuzz-{}.store", std::process::id()));
    tsdfuse_store::fuzzing::store(&path, bytes);
    let _ = std::fs::remove_file(path);
});
