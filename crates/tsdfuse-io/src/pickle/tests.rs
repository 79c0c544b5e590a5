use std::io::Write;
use std::path::PathBuf;

use proptest::prelude::*;

use super::machine;
use super::*;

/// The small pickles of `testdata/pickle/make.py`: one table, as six versions of pandas store it.
fn stored() -> Vec<(String, Vec<u8>)> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("testdata/pickle");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e != "py"));
    files.sort();
    let named = |f: PathBuf| (f.file_name().unwrap().to_string_lossy().into_owned(), load(&f).unwrap());
    files.into_iter().map(named).collect()
}

fn stored_as(name: &str) -> Vec<u8> {
    stored().into_iter().find(|(n, _)| n == name).unwrap().1
}

/// `bytes` with the one place where `from` stands changed to `to`.
fn patched(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let places: Vec<_> = (0..bytes.len()).filter(|&i| bytes[i..].starts_with(from)).collect();
    assert_eq!(places.len(), 1, "{from:?} stands at {places:?}");
    [&bytes[..places[0]], to, &bytes[places[0] + from.len()..]].concat()
}

fn reason(pickle: &[u8]) -> String {
    let reason = DataFrame::new(pickle).unwrap_err();
    assert!(!reason.contains('\n'), "{reason}");
    reason
}

fn read_everything(pickle: &[u8]) {
    if let Ok(table) = DataFrame::new(pickle) {
        for name in ["x", "y", "z", "i", "t", "d", "name", "q"] {
            let _ = table.column(name);
        }
    }
}

#[test]
fn all_layouts_of_pandas_hold_the_same_numbers() {
    let stored = stored();
    assert_eq!(stored.len(), 12);
    for (name, pickle) in stored {
        let table = DataFrame::new(&pickle).unwrap_or_else(|e| panic!("{name}: {e}"));
        type Formula = fn(f64) -> f64;
        let expected: [(&str, Formula); 6] = [
            ("x", |k| k * 1.5 - 3.0),
            ("y", |k| k * 2.25),
            ("z", |k| k * -0.5),
            ("i", |k| k * 10.0),
            ("t", |k| 1557539960.0 + k * 0.0078125),
            ("d", |k| if k > 3.0 { 1.0 } else { 0.0 }),
        ];
        for (column, f) in expected {
            let numbers: Vec<f64> = (0..7).map(|k| f(f64::from(k))).collect();
            assert_eq!(table.column(column), Ok(numbers), "{name}, {column}");
        }
        assert_eq!(table.column("w"), Err("no column 'w'".into()), "{name}");
    }
}

#[test]
fn a_column_of_text_is_an_error_only_where_it_is_asked_for() {
    let pickle = stored_as("pandas2.3_mixed_p4.pkl");
    let table = DataFrame::new(&pickle).unwrap();
    assert_eq!(
        table.column("name"),
        Err("column 'name': an array of type 'O8' instead of numbers".into())
    );
}

#[test]
fn truncated_pickles_are_errors() {
    for (name, pickle) in stored() {
        for n in 0..pickle.len() {
            assert!(DataFrame::new(&pickle[..n]).is_err(), "{name} cut to {n} bytes");
        }
    }
    assert_eq!(
        reason(&stored_as("pandas2.3_p5.pkl")[..300]),
        "byte 192 of the pickle: the file ends here"
    );
}

#[test]
fn gzip_files_are_checked_to_their_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("00.pkl.gz");
    let stored = std::fs::read(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("testdata/pickle/pandas1.0_p3.pkl.gz"));
    let stored = stored.unwrap();
    for n in 2..stored.len() {
        std::fs::write(&path, &stored[..n]).unwrap();
        let message = load(&path).unwrap_err().to_string();
        assert!(
            message.contains("00.pkl.gz: cannot be read after") && !message.contains('\n'),
            "{message}"
        );
    }
    let mut flipped = stored.clone();
    *flipped.last_mut().unwrap() ^= 1;
    std::fs::write(&path, flipped).unwrap();
    assert!(load(&path).is_err());
}

#[test]
fn a_file_that_grows_without_end_is_stopped() {
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    gz.write_all(&vec![0; 1 << 20]).unwrap();
    let gz = gz.finish().unwrap();
    assert!(gz.len() < 2000);
    let read = |max| read_at_most(flate2::read::GzDecoder::new(gz.as_slice()), max, 0);
    assert_eq!(read(1 << 20).unwrap().len(), 1 << 20);
    assert_eq!(
        read((1 << 20) - 1).unwrap_err(),
        "grows beyond 1048575 bytes: no scan is that large"
    );
}

#[test]
fn foreign_classes_are_named_and_never_called() {
    for (pickle, class) in [
        (&b"\x80\x02cos\nsystem\nX\x02\x00\x00\x00ls\x85R."[..], "os.system"),
        (
            b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93\x8c\x011\x85R.",
            "builtins.eval",
        ),
        (b"\x80\x02cpandas\nread_pickle\n.", "pandas.read_pickle"),
        (b"\x80\x02ca\rb\nc\x1b\n.", "a\\rb.c\\u{1b}"),
    ] {
        assert_eq!(
            reason(pickle),
            format!("foreign class {class}: only DataFrames of numbers are read")
        );
    }
}

#[test]
fn counts_that_the_bytes_do_not_bear_out_are_errors() {
    let good = stored_as("pandas2.3_p5.pkl");
    let shape = b"K\x05K\x07\x86";
    let slice = b"K\x00K\x05K\x01\x87";
    let length = [&[0x96], 280_u64.to_le_bytes().as_slice()].concat();
    let endless = [&[0x96], u64::MAX.to_le_bytes().as_slice()].concat();
    for (from, to, expected) in [
        (
            &shape[..],
            &b"K\x05K\x09\x86"[..],
            "column 'x': an array of 5 x 9 f8 in 280 bytes",
        ),
        (shape, b"K\x07K\x05\x86", "a block of 7 rows for 5 columns"),
        (
            shape,
            b"K\x05J\xff\xff\xff\xff\x86",
            "column 'x': an array of negative size",
        ),
        (
            shape,
            b"\x8a\x08\xff\xff\xff\xff\xff\xff\xff\x7fK\x07\x86",
            "column 'x': an array of 9223372036854775807 x 7 f8 in 280 bytes",
        ),
        (shape, b"K\x05K\x07K\x01\x87", "column 'x': an array of 3 dimensions"),
        (slice, b"K\x00K\x06K\x01\x87", "a block of 5 rows for 6 columns"),
        (slice, b"K\x01K\x06K\x01\x87", "a column with two blocks of values"),
        (
            slice,
            b"K\x03K\x08K\x01\x87",
            "a block of 5 columns that are not all in the table",
        ),
        (slice, b"K\x00K\x05K\x00\x87", "a block of 5 rows for 0 columns"),
        (
            slice,
            b"\x8a\x08\x00\x00\x00\x00\x00\x00\x00\x80K\x05K\x01\x87",
            "a block of 5 rows for 0 columns",
        ),
        (&length, &endless, "byte 192 of the pickle: the file ends here"),
    ] {
        let bad = patched(&good, from, to);
        let found = DataFrame::new(&bad).and_then(|table| table.column("x").map(|_| String::new()));
        assert_eq!(found.unwrap_err(), expected);
    }
    // The 56 bytes of column d, read as 14 integers of 4 bytes.
    let longer = patched(
        &patched(&good, b"\x8c\x02i8", b"\x8c\x02i4"),
        b"K\x01K\x07\x86",
        b"K\x01K\x0e\x86",
    );
    assert_eq!(reason(&longer), "columns of 7 and of 14 rows");
}

#[test]
fn stack_and_memo_stay_bounded() {
    let endless = "needs more than 1048576 operations: no DataFrame of numbers does";
    for operation in [
        &b"("[..],
        b")",
        b"N2",
        b")\x85",
        b"]2a",
        b"}NNs",
        b"\x94",
        b"Nr\xff\xff\xff\xff",
        b"Nq\x00",
    ] {
        let pickle = [b"\x80\x04N".as_slice(), &operation.repeat(1 << 20)].concat();
        assert_eq!(reason(&pickle), endless, "{operation:?}");
    }
    for (pickle, expected) in [
        (&b""[..], "is no pickle of protocol 2 or later"),
        (b"(dp0\n.", "is no pickle of protocol 2 or later"),
        (b"\x80", "byte 0 of the pickle: the file ends here"),
        (
            b"\x80\x02.",
            "byte 2 of the pickle: takes more from the stack than there is",
        ),
        (
            b"\x80\x02N(\x86.",
            "byte 4 of the pickle: takes more from the stack than there is",
        ),
        (
            b"\x80\x02N(0.",
            "byte 4 of the pickle: takes more from the stack than there is",
        ),
        (b"\x80\x02N1.", "byte 3 of the pickle: no MARK is open"),
        (
            b"\x80\x02h\x05.",
            "byte 2 of the pickle: recalls what was never memoized",
        ),
        (b"\x80\x02NNa.", "byte 4 of the pickle: changes what cannot be changed"),
        (b"\x80\x02)Na.", "byte 4 of the pickle: appends to what is no list"),
        (b"\x80\x02}(Nu.", "byte 5 of the pickle: a key without a value"),
        (b"\x80\x02N)R.", "byte 4 of the pickle: calls what is no class"),
        (
            b"\x80\x02)Nb.",
            "byte 4 of the pickle: sets the state of what is no object",
        ),
        (
            b"\x80\x02\x8a\x09\x01\x01\x01\x01\x01\x01\x01\x01\x01.",
            "byte 2 of the pickle: an integer of more than 64 bits",
        ),
        (b"\x80\x02](NNu.", "byte 6 of the pickle: sets a key of what is no dict"),
        (
            b"\x80\x02C\x01\xffX\x01\x00\x00\x00\xff.",
            "byte 5 of the pickle: text that is not UTF-8",
        ),
        (
            b"\x80\x02Pid\n.",
            "byte 2 of the pickle: an operation that DataFrames do not need",
        ),
        (b"\x80\x02N.", "holds no pandas DataFrame of a known layout"),
    ] {
        assert_eq!(reason(pickle), expected);
    }
    // A list that holds itself, as the table's columns.
    assert!(machine::run(b"\x80\x02]q\x00h\x00a.").is_ok());
}

#[test]
fn memory_follows_the_bytes_that_are_there() {
    // One long text, encoded twice.
    let text = [b"X".as_slice(), &1000_u32.to_le_bytes(), &[b'a'; 1000]].concat();
    let encode = b"h\x00h\x01X\x06\x00\x00\x00latin1\x86R".as_slice();
    let start = [b"\x80\x02c_codecs\nencode\nq\x00", text.as_slice(), b"q\x01"].concat();
    assert!(machine::run(&[&start, encode, b"."].concat()).is_ok());
    assert!(reason(&[&start, encode, encode, b"."].concat()).ends_with("encodes the same text again and again"));
    assert!(
        reason(b"\x80\x02c_codecs\nencode\nX\x01\x00\x00\x00aX\x03\x00\x00\x00hex\x86R.").ends_with("no Latin-1 text")
    );

    // Columns of one byte a number would grow eightfold.
    let good = stored_as("pandas2.3_p5.pkl");
    let long = [&[0x96], (1_u64 << 23).to_le_bytes().as_slice(), &vec![0; 1 << 23]].concat();
    let at = good
        .windows(9)
        .position(|w| w == [&[0x96], 56_u64.to_le_bytes().as_slice()].concat())
        .unwrap();
    let mut long = [&good[..at], &long, &good[at + 9 + 56..]].concat();
    long = patched(&long, b"\x8c\x02i8", b"\x8c\x02i1");
    long = patched(&long, b"K\x01K\x07\x86", b"K\x01J\x00\x00\x80\x00\x86");
    assert_eq!(reason(&long), "8388608 rows: no scan has more than 4194304");

    let names = patched(
        &stored_as("pandas3.0_arrow_p5.pkl"),
        b"K\x06K\x00K\x00",
        b"J\x06\x00\x00\x10K\x00K\x00",
    );
    assert_eq!(reason(&names), "the names of the columns have an unknown layout");
}

#[test]
fn integers_keep_their_sign() {
    for (pickle, expected) in [
        (&b"\x80\x02\x8a\x00."[..], 0),
        (b"\x80\x02\x8a\x01\xff.", -1),
        (b"\x80\x02\x8a\x02\xff\x00.", 255),
        (b"\x80\x02J\xfe\xff\xff\xff.", -2),
        (b"\x80\x02M\xfe\xff.", 65534),
    ] {
        let root = machine::run(pickle).unwrap().root;
        assert!(matches!(root, graph::Value::Int(n) if n == expected), "{root:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn random_bytes_never_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        bytes.splice(0..0, *b"\x80\x04");
        read_everything(&bytes);
    }

    #[test]
    fn random_operations_never_panic(
        operations in prop::collection::vec(prop::sample::select(b"N().]}tl0122\x85\x86aesubhq\x94KJRKd\x93\x8c\x01".to_vec()), 0..300),
    ) {
        read_everything(&[b"\x80\x04", operations.as_slice()].concat());
    }

    #[test]
    fn random_damage_never_panics(
        file in 0..12_usize,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3_u8), 1..6),
    ) {
        let (_, mut pickle) = stored().swap_remove(file);
        for (at, byte, kind) in damage {
            let at = at.index(pickle.len());
            match kind {
                0 => pickle[at] = byte,
                1 => pickle.insert(at, byte),
                _ => drop(pickle.remove(at)),
            }
        }
        read_everything(&pickle);
    }
}
