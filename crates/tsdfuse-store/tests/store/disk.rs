//! Disks that are full, files that cannot be written, and several processes.

use std::path::Path;
use std::process::Command;

use tsdfuse::fuse::{FuseConfig, Method};
use tsdfuse::glam::IVec3;
use tsdfuse::map::Block;
use tsdfuse::{VoxelMap, index::BlockIndex};
use tsdfuse_store::{PagedError, PagedMap, StoreError};

use super::{LITTLE, all_of, config, drive, fused, fused_with_little, new_store, whole};

/// Where the child process of [`a_full_disk_is_told_and_the_last_commit_survives`] has its store.
const FULL_DISK: &str = "TSDFUSE_TEST_FULL_DISK";

/// Not a test of its own: fuses until the file cannot grow, as on a full disk.
#[test]
fn child_on_a_full_disk() {
    let Ok(path) = std::env::var(FULL_DISK) else { return };
    let (sensor, scans) = drive();
    let mut method = Method::Raycast.build(&FuseConfig::default(), Some(&sensor));
    let (mut paged, _) = PagedMap::open(&path, LITTLE).unwrap();
    let mut first = None;
    for scan in &scans[6..] {
        let told = match paged.integrate(&mut *method, scan) {
            Ok(_) => paged.commit(b"more").err(),
            Err(PagedError::Store(error)) => Some(error),
            Err(PagedError::Fuse(error)) => panic!("{error}"),
        };
        match (&first, told) {
            (None, Some(error)) => first = Some(error.to_string()),
            // From then on every call says why.
            (Some(first), Some(error)) => {
                assert!(
                    matches!(error, StoreError::Broken { .. }) && error.to_string().starts_with(first),
                    "{error}"
                );
            }
            (None, None) => std::fs::write(format!("{path}.commits"), paged.integrations().to_string()).unwrap(),
            (Some(_), None) => panic!("it went on"),
        }
    }
    let first = first.unwrap();
    assert!(
        first.contains("a.store: ") && first.contains("File too large"),
        "{first}"
    );
}

#[cfg(unix)]
#[test]
fn a_full_disk_is_told_and_the_last_commit_survives() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let (sensor, scans) = drive();
    let mut paged = new_store(&path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..6], &[6]);
    drop(paged);
    let kilobytes = std::fs::metadata(&path).unwrap().len() / 1024;
    // dash counts in units of 512 bytes, bash in 1024.
    let script = format!(
        "trap '' XFSZ; ulimit -f {}; exec \"$0\" disk::child_on_a_full_disk --exact --nocapture",
        3 * kilobytes
    );
    let child = Command::new("bash")
        .args(["-c", &script])
        .arg(std::env::current_exe().unwrap())
        .env(FULL_DISK, &path)
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&child.stderr);
    assert!(
        child.status.success() && String::from_utf8_lossy(&child.stdout).contains("1 passed"),
        "{told}"
    );
    // The last commit that succeeded, or the one that was being made: its header may have been written before its
    // second copy failed.
    let commits = std::fs::read_to_string(dir.path().join("a.store.commits")).unwrap();
    let commits: usize = commits.parse().unwrap();
    let (paged, checkpoint) = PagedMap::open(&path, LITTLE).unwrap();
    assert_eq!(
        (checkpoint.as_slice(), paged.integrations() as usize),
        (&b"more"[..], commits)
    );
    assert!(
        commits > 6 && whole(paged) == fused(Method::Raycast, &sensor, &scans[..commits]),
        "{commits}"
    );
}

#[test]
fn a_store_can_be_read_where_nothing_can_be_written_and_by_several() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let (sensor, scans) = drive();
    let mut paged = new_store(&path);
    fused_with_little(&mut paged, Method::Raycast, &sensor, &scans[..8], &[6]);
    // While it is written, nobody reads it.
    let told = PagedMap::open_read_only(&path, LITTLE).map(drop).unwrap_err();
    assert!(
        told.to_string().ends_with("a.store: another process has it open"),
        "{told}"
    );
    // As if the process had been killed.
    drop(paged);
    let before = std::fs::read(&path).unwrap();
    read_only(&path, true);
    read_only(dir.path(), true);
    let [(mut a, checkpoint), (mut b, _)] = [(); 2].map(|()| PagedMap::open_read_only(&path, LITTLE).unwrap());
    assert_eq!((checkpoint.as_slice(), a.integrations()), (&b"6"[..], 6));
    let expected = fused(Method::Raycast, &sensor, &scans[..6]);
    assert!(all_of(&mut a).unwrap() == expected && all_of(&mut b).unwrap() == expected);
    assert!(a.most_bytes() < expected.memory_bytes());
    // It is not changed.
    let mut method = Method::Raycast.build(&FuseConfig::default(), Some(&sensor));
    let refused = |error: StoreError| {
        assert!(matches!(error, StoreError::ReadOnly { .. }), "{error}");
        assert!(error.to_string().ends_with("a.store: is open for reading only"));
    };
    refused(a.commit(b"").unwrap_err());
    refused(a.put_block(BlockIndex(IVec3::ZERO), Block::EMPTY).unwrap_err());
    match a.integrate(&mut *method, &scans[0]).unwrap_err() {
        PagedError::Store(error) => refused(error),
        PagedError::Fuse(error) => panic!("{error}"),
    }
    assert!(all_of(&mut a).unwrap() == expected);
    // While it is read, nobody writes it.
    read_only(dir.path(), false);
    read_only(&path, false);
    let told = PagedMap::open(&path, LITTLE).map(drop).unwrap_err();
    assert!(
        told.to_string().ends_with("a.store: another process has it open"),
        "{told}"
    );
    assert!(!tsdfuse_store::remove_unused(&path));
    drop((a, b));
    assert!(std::fs::read(&path).unwrap() == before);
    drop(PagedMap::open(&path, LITTLE).unwrap());
    assert!(tsdfuse_store::remove_unused(&path) && !path.exists());
}

fn read_only(path: &Path, is_read_only: bool) {
    let mut permissions = std::fs::metadata(path).unwrap().permissions();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = permissions.mode();
        permissions.set_mode(if is_read_only { mode & !0o222 } else { mode | 0o200 });
    }
    #[cfg(not(unix))]
    permissions.set_readonly(is_read_only);
    std::fs::set_permissions(path, permissions).unwrap();
}

#[test]
fn the_file_does_not_grow_with_every_commit() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.store");
    let mut paged = PagedMap::create(&path, VoxelMap::new(config()).unwrap(), b"", None).unwrap();
    let (sensor, scans) = drive();
    let mut method = Method::Raycast.build(&FuseConfig::default(), Some(&sensor));
    let mut sizes = Vec::new();
    for _ in 0..12 {
        paged.integrate(&mut *method, &scans[0]).unwrap();
        paged.commit(b"").unwrap();
        sizes.push(paged.store_bytes());
    }
    // What the commit before needed is free after the next one.
    assert!(sizes[11] <= sizes[4] + sizes[4] / 4, "{sizes:?}");
}
