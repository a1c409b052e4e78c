//! What the program listens on: nothing beyond this computer unless asked.
#![cfg(target_os = "linux")]

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::Duration;

use crate::process::{PATIENCE, Running, program, rig};
use crate::program::scratch;

/// An address as `/proc` writes it: words in the machine's order, port in network order.
fn address(text: &str) -> SocketAddr {
    let (ip, port) = text.split_once(':').expect("address:port");
    let words: Vec<u32> = (0..ip.len() / 8)
        .map(|k| u32::from_str_radix(&ip[8 * k..8 * k + 8], 16).expect("a word"))
        .collect();
    let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_ne_bytes()).collect();
    let ip = match <[u8; 4]>::try_from(bytes.as_slice()) {
        Ok(four) => IpAddr::V4(Ipv4Addr::from(four)),
        Err(_) => {
            let all = <[u8; 16]>::try_from(bytes.as_slice()).expect("sixteen bytes");
            IpAddr::V6(Ipv6Addr::from(all))
        }
    };
    SocketAddr::new(ip, u16::from_str_radix(port, 16).expect("a port"))
}

/// The sockets of a process and its children on which others can reach it: TCP that listens, UDP.
fn listeners(pid: u32) -> Vec<(String, SocketAddr)> {
    let mut inodes = Vec::new();
    let Ok(files) = std::fs::read_dir(format!("/proc/{pid}/fd")) else {
        return Vec::new();
    };
    for file in files.flatten() {
        let Ok(to) = std::fs::read_link(file.path()) else {
            continue;
        };
        if let Some(inode) = to.to_string_lossy().strip_prefix("socket:[") {
            inodes.push(inode.trim_end_matches(']').to_owned());
        }
    }
    let mut out = Vec::new();
    for kind in ["tcp", "tcp6", "udp", "udp6"] {
        let table = std::fs::read_to_string(format!("/proc/{pid}/net/{kind}")).unwrap_or_default();
        for line in table.lines().skip(1) {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let (local, state, inode) = (fields[1], fields[3], fields[9]);
            let open = kind.starts_with("udp") || state == "0A";
            if open && inodes.iter().any(|i| i == inode) {
                out.push((kind.to_owned(), address(local)));
            }
        }
    }
    let children = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"));
    for child in children.unwrap_or_default().split_whitespace() {
        out.extend(listeners(child.parse().expect("a process")));
    }
    out
}

/// What a running program listens on, once it has been looked at for a while.
fn watched(
    run: &Running,
    wanted: impl Fn(&[(String, SocketAddr)]) -> bool,
) -> Vec<(String, SocketAddr)> {
    let (nap, mut naps) = (Duration::from_millis(20), 0);
    let mut all: Vec<(String, SocketAddr)> = Vec::new();
    loop {
        for l in listeners(run.id()) {
            if !all.contains(&l) {
                all.push(l);
            }
        }
        // Two seconds at least, so that what opens late is seen, too.
        if (naps > 100 && wanted(&all)) || nap * naps > PATIENCE {
            return all;
        }
        std::thread::sleep(nap);
        naps += 1;
    }
}

fn start(args: &[&str]) -> Running {
    Running::start(program(args).stderr(std::process::Stdio::null()))
}

#[test]
fn sockets_are_on_loopback_unless_asked() {
    let long = ["run", "--headless", "--seconds", "1000000", "--rig"];
    let mut run = start(&[&long[..], &["sim"]].concat());
    let found = watched(&run, |_| true);
    assert!(!run.has_ended(), "it still runs");
    assert_eq!(found, [], "a rig in the process needs no socket");
    drop(run);

    // Hardware: a rig process behind a pseudo-terminal, named as a port.
    let dir = scratch("fault-listeners");
    let port = dir.join("port");
    let port = port.to_str().expect("utf-8");
    let (_rig, _) = rig(&["--link", port]);

    let hardware = [&long[..], &[port]].concat();
    // Another program may have motion capture's port: then there is none, nothing to look at, and it says so.
    let mut run = Running::start(program(&hardware).env("RUST_LOG", "warn"));
    let log = run.log();
    let by_default = watched(&run, |l| !l.is_empty());
    let is_taken = log
        .try_iter()
        .any(|line| line.contains("no motion capture"));
    assert!(
        by_default.iter().all(|(_, a)| a.ip().is_loopback()),
        "{by_default:?}"
    );
    assert!(
        is_taken || !by_default.is_empty(),
        "motion capture is listened for"
    );
    drop(run);

    // As asked, and only there. The port was free a moment ago.
    let free = UdpSocket::bind("0.0.0.0:0").expect("a port");
    let asked = free.local_addr().expect("is bound");
    drop(free);
    let asked_text = asked.to_string();
    let run = start(&[&hardware[..], &["--mocap-listen", &asked_text]].concat());
    let there = watched(&run, |l| !l.is_empty());
    assert_eq!(there, [("udp".to_owned(), asked)]);
    println!("hardware listens on {by_default:?} by default");
}

/// The addresses of SECURITY.md's table of listeners that are open `when`.
fn stated(when: &str) -> Vec<IpAddr> {
    let page = include_str!("../../../SECURITY.md");
    let table = page.split("## Listeners").nth(1).expect("a table");
    let table = table.split("\n## ").next().expect("its section");
    let address = |row: &str| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let is_meant = cells.get(1)?.split(", ").any(|w| w.starts_with(when));
        let first = cells.get(2)?.split('`').nth(1)?;
        let ip = first.split(':').next()?.parse().expect("an address");
        is_meant.then_some(ip)
    };
    table.lines().filter_map(address).collect()
}

#[test]
fn the_table_of_listeners_states_what_the_program_opens() {
    let long = ["run", "--headless", "--seconds", "1000000", "--rig"];
    for (args, when) in [
        ([&long[..], &["sim"]].concat(), "`--rig sim`"),
        ([&long[..], &["pty"]].concat(), "`--rig pty`"),
        (vec!["rig", "--vicon", "127.0.0.1:9"], "`rig --vicon`"),
    ] {
        let stated = stated(when);
        let run = start(&args);
        let found = watched(&run, |l| l.len() >= stated.len());
        assert!(found.iter().all(|(kind, _)| kind == "udp"), "{found:?}");
        let found: Vec<IpAddr> = found.iter().map(|(_, at)| at.ip()).collect();
        assert_eq!(found, stated, "{when}");
    }
    // Motion capture's port on hardware may be taken here: its bounds are those of the test above.
    assert_eq!(stated("`--rig PORT`"), [IpAddr::V4(Ipv4Addr::LOCALHOST)]);
}

#[test]
fn addresses_are_read_as_the_system_writes_them() {
    if cfg!(target_endian = "little") {
        assert_eq!(
            address("0100007F:C739"),
            "127.0.0.1:51001".parse().expect("an address")
        );
        let v6 = address("00000000000000000000000001000000:0050");
        assert_eq!(v6, "[::1]:80".parse().expect("an address"));
    }
}
