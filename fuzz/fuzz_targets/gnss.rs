#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tsdfuse_io::fuzzing::gnss(bytes));
