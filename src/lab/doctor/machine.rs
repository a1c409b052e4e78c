//! Checks that try what the program will do on this computer: open ports, bind addresses, write files.

use std::io::Write as _;
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};

use super::Check;
use crate::link::serial;
use crate::recording::{RollingFolder, free_bytes};

/// What an hour of recording takes, bytes.
const HOUR_BYTES: u64 = 480_000_000;
/// Free space below this many hours of recording is warned of.
const WORKING_DAY_H: u64 = 8;

/// The ports there are; or, of those that are named (separated by commas), whether each opens.
pub(super) fn ports(named: Option<&str>) -> Vec<Check> {
    let Some(named) = named else {
        return vec![listed()];
    };
    let names = named.split(',').map(str::trim).filter(|n| !n.is_empty());
    let opened = |name: &str| match serial::check(name) {
        Ok(()) => (true, format!("{name} opens")),
        Err(e) => (false, e.to_string()),
    };
    let checks = names.map(opened);
    checks.map(|found| Check::of("port", found)).collect()
}

fn listed() -> Check {
    let says = match crate::link::ports::list() {
        Err(e) => format!("the system does not list its serial ports: {e}"),
        Ok(found) if found.is_empty() => {
            "no serial port: connect the boards, or use the virtual rig".to_owned()
        }
        Ok(found) => {
            let names: Vec<&str> = found.iter().map(|p| p.name.as_str()).collect();
            format!("{}; --rig PORT opens one", names.join(", "))
        }
    };
    // The virtual rig needs none.
    Check::of("ports", (true, says))
}

/// Whether motion capture can be received at `address`.
pub(super) fn mocap(address: SocketAddr) -> Check {
    let found = match UdpSocket::bind(address) {
        Ok(_) => (true, format!("{address} (UDP) can be bound")),
        Err(e) => (
            false,
            format!(
                "{address} (UDP) cannot be bound ({e}): close the program that has it, such as another springtwin with \
                 hardware, or choose an address of this computer with --mocap-listen"
            ),
        ),
    };
    Check::of("mocap", found)
}

/// Where the window's log is kept.
pub(super) fn log(path: Option<&Path>) -> Check {
    let found = match path.map(|p| (p.display(), std::fs::metadata(p))) {
        None => (
            false,
            "the window's log is not kept: this user has no folder for data (set HOME)".to_owned(),
        ),
        Some((path, Ok(file))) => (
            true,
            format!(
                "the window's log is {path} ({} kB)",
                file.len().div_ceil(1000)
            ),
        ),
        Some((path, Err(_))) => (true, format!("the window's log goes to {path}")),
    };
    Check::of("log", found)
}

/// Whether recordings can be made in a folder, or where it will be made: a file is written there and removed.
pub(super) fn recordings(folder: &Path) -> Check {
    Check::of("recordings", writable(folder))
}

/// Rolling recordings: where, how much, and the limit.
pub(super) fn rolling(folder: Option<&RollingFolder>) -> Check {
    let text = match folder {
        None => "off: this user has no data folder".to_owned(),
        Some(folder) => {
            let (used, limit) = (folder.used_bytes(), folder.limit_bytes());
            let gb = |bytes: u64| bytes as f64 * 1e-9;
            let shown = folder.path().display();
            match limit {
                0 => format!("off; {:.2} GB are in {shown}", gb(used)),
                _ => format!(
                    "{:.2} GB of at most {:.1} GB in {shown}",
                    gb(used),
                    gb(limit)
                ),
            }
        }
    };
    Check::of("rolling", (true, text))
}

/// The nearest folder that is there.
fn there(folder: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let mut all = absolute.ancestors();
    all.find(|dir| dir.exists()).map(Path::to_owned)
}

fn writable(folder: &Path) -> (bool, String) {
    let shown = folder.display();
    let Some(there) = there(folder) else {
        return (false, format!("there is no disk for the folder {shown}"));
    };
    let exists = folder.exists();
    if let Err(e) = probe(&there) {
        let why = match exists {
            true => "it cannot be written".to_owned(),
            false => format!("it cannot be made in {}", there.display()),
        };
        return (
            false,
            format!(
                "the folder {shown}: {why} ({e}); give yourself the right to, or choose another in the window"
            ),
        );
    }
    match exists {
        true => (true, format!("they go to {shown}")),
        false => (
            true,
            format!("they go to {shown}, which is made with the first one"),
        ),
    }
}

/// Writes a file into a folder, up to the disk, and removes it.
fn probe(folder: &Path) -> std::io::Result<()> {
    let path = folder.join(format!(".springtwin-doctor-{}", std::process::id()));
    let mut file = std::fs::File::create_new(&path)?;
    let written = file.write_all(&[0x55; 4096]).and_then(|()| file.sync_all());
    drop(file);
    std::fs::remove_file(&path)?;
    written
}

/// How much more can be recorded.
pub(super) fn disk(folder: &Path) -> Check {
    let free = there(folder).and_then(|dir| free_bytes(&dir.join("recording")));
    let found = match free {
        None => (true, "the system does not report its free space".to_owned()),
        Some(free) => space(free),
    };
    Check::of("disk", found)
}

fn space(free: u64) -> (bool, String) {
    let (gb, hours) = (free as f64 * 1e-9, free / HOUR_BYTES);
    let text = format!("{gb:.1} GB free for recordings, about {hours} h");
    match hours >= WORKING_DAY_H {
        true => (true, text),
        false => (
            false,
            format!("{text}: remove files, or choose another folder in the window"),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rolling_recording_is_named_with_folder_size_and_limit() {
        let name = format!("springtwin-doctor-rolling-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let folder = RollingFolder::of(path.clone());
        let shown = path.display().to_string();
        let stated = || rolling(Some(&folder)).says;
        assert_eq!(stated(), format!("0.00 GB of at most 2.0 GB in {shown}"));
        folder.set_limit(0).expect("is kept");
        let file = path.join("rolling_2026-11-23_14-05-12_ab.rrd");
        std::fs::write(file, vec![0; 30_000_000]).expect("writes");
        let off = stated();
        std::fs::remove_dir_all(&path).expect("removed");
        assert_eq!(off, format!("off; 0.03 GB are in {shown}"));
    }

    #[test]
    fn recordings_need_a_folder_that_is_there_or_can_be_made() {
        let name = format!("springtwin-doctor-{}", std::process::id());
        let home = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&home).expect("a folder");
        let (ok, says) = writable(&home);
        assert!(ok && says.ends_with(&*home.display().to_string()), "{says}");
        let (ok, says) = writable(&home.join("a/recordings"));
        assert!(
            ok && says.ends_with("which is made with the first one"),
            "{says}"
        );
        let left = std::fs::read_dir(&home).expect("is there").count();
        assert_eq!(left, 0, "the probe is removed");
        let file = home.join("file");
        std::fs::write(&file, "").expect("writes");
        let (ok, says) = writable(&file.join("recordings"));
        std::fs::remove_dir_all(&home).expect("removed");
        assert!(!ok && says.contains("it cannot be made in"), "{says}");
    }

    /// A folder whose rights allow what its file system does not.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_is_tried_and_not_only_looked_at() {
        let (ok, says) = writable(Path::new("/proc"));
        assert!(!ok && says.contains("it cannot be written ("), "{says}");
    }

    #[test]
    fn an_address_that_another_program_has_is_warned_of() {
        let held = UdpSocket::bind("127.0.0.1:0").expect("a port");
        let address = held.local_addr().expect("its address");
        let check = mocap(address);
        assert!(
            !check.ok && check.says.contains("--mocap-listen"),
            "{check:?}"
        );
        drop(held);
        assert!(mocap("127.0.0.1:0".parse().expect("an address")).ok);
    }

    #[test]
    fn ports_that_are_named_are_opened_one_by_one() {
        let checks = ports(Some("/dev/springtwin-none, /dev/springtwin-other"));
        assert_eq!(checks.len(), 2);
        for (check, name) in checks.iter().zip(["none", "other"]) {
            assert!(!check.ok && check.says.contains(name), "{check:?}");
            assert!(check.says.contains("Check the cable"), "{check:?}");
        }
    }

    #[test]
    fn less_than_a_working_day_of_free_space_is_warned_of() {
        let (ok, says) = space(100_000_000_000);
        assert!(ok && says.contains("about 208 h"), "{says}");
        let (ok, says) = space(3_000_000_000);
        assert!(
            !ok && says.contains("3.0 GB") && says.contains("about 6 h"),
            "{says}"
        );
    }
}
