//! The serial ports of the computer, as they come and go.

use serialport::{SerialPortInfo, SerialPortType};

use crate::signal::Stamp;

/// Time between two looks, s.
const PERIOD_S: f64 = 1.0;

/// A serial port.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PortInfo {
    /// Path or name to open it by.
    pub name: String,
    /// What is behind it, as far as the operating system reports; may be empty.
    pub what: String,
    /// Serial number of the USB device behind it; `None` where there is none or the system gives none.
    pub usb_serial: Option<String>,
}

/// A change of the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortChange {
    /// It was not there before.
    Appeared(PortInfo),
    /// It is not there any more.
    Gone(PortInfo),
}

impl PortChange {
    /// One sentence for the operator.
    pub fn text(&self) -> String {
        let told = |p: &PortInfo| match p.what.is_empty() {
            true => p.name.clone(),
            false => format!("{} ({})", p.name, p.what),
        };
        match self {
            Self::Appeared(p) => format!("Serial port {} appeared.", told(p)),
            Self::Gone(p) => format!("Serial port {} is gone.", told(p)),
        }
    }
}

/// The ports there are now, in order of name.
///
/// # Errors
/// The system's error.
pub fn list() -> Result<Vec<PortInfo>, serialport::Error> {
    Ok(described(serialport::available_ports()?))
}

fn described(found: Vec<SerialPortInfo>) -> Vec<PortInfo> {
    let mut ports: Vec<PortInfo> = found
        .into_iter()
        .map(|p| PortInfo {
            usb_serial: match &p.port_type {
                SerialPortType::UsbPort(usb) => usb.serial_number.clone(),
                _ => None,
            },
            what: match p.port_type {
                SerialPortType::UsbPort(usb) => {
                    let parts = [usb.manufacturer, usb.product, usb.serial_number];
                    let known: Vec<String> = parts.into_iter().flatten().collect();
                    match known.is_empty() {
                        true => format!("USB {:04x}:{:04x}", usb.vid, usb.pid),
                        false => known.join(" "),
                    }
                }
                SerialPortType::BluetoothPort => "Bluetooth".to_owned(),
                SerialPortType::PciPort | SerialPortType::Unknown => String::new(),
            },
            name: p.port_name,
        })
        .collect();
    ports.sort();
    ports
}

/// How the list is got; `None` when the operating system has none.
type Look = Box<dyn FnMut() -> Option<Vec<PortInfo>> + Send>;

/// Watches the list; looks at most once a second.
pub struct PortWatch {
    look: Look,
    known: Vec<PortInfo>,
    next: Stamp,
}

impl Default for PortWatch {
    fn default() -> Self {
        Self::of(list().unwrap_or_default())
    }
}

impl PortWatch {
    /// Watches the system's ports, of which these are known.
    pub fn of(known: Vec<PortInfo>) -> Self {
        Self::new(known, Box::new(|| list().ok()))
    }

    /// Watches what `look` gives.
    fn new(known: Vec<PortInfo>, look: Look) -> Self {
        Self {
            look,
            known,
            next: Stamp::ZERO,
        }
    }

    /// Ports known to be present.
    pub fn known(&self) -> &[PortInfo] {
        &self.known
    }

    /// Changes since the last query, if it is time for one.
    pub fn poll(&mut self, now: Stamp) -> Vec<PortChange> {
        if now < self.next {
            return Vec::new();
        }
        self.next = now.plus(PERIOD_S);
        // A failed query changes no port.
        let Some(fresh) = (self.look)() else {
            return Vec::new();
        };
        let missing = |from: &[PortInfo], p: &&PortInfo| !from.contains(p);
        let gone = self.known.iter().filter(|p| missing(&fresh, p));
        let come = fresh.iter().filter(|p| missing(&self.known, p));
        let changes = gone
            .map(|p| PortChange::Gone(p.clone()))
            .chain(come.map(|p| PortChange::Appeared(p.clone())))
            .collect();
        self.known = fresh;
        changes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn port(name: &str, what: &str) -> PortInfo {
        PortInfo {
            name: name.into(),
            what: what.into(),
            usb_serial: None,
        }
    }

    #[test]
    fn ports_come_and_go_and_a_swap_behind_one_name_is_both() {
        let a = port("/dev/ttyACM0", "Arduino Mega 2560 1");
        let b = port("/dev/ttyACM1", "");
        let other = port("/dev/ttyACM0", "Arduino Mega 2560 2");
        let mut looks = vec![
            Some(vec![a.clone()]),
            Some(vec![a.clone(), b.clone()]),
            None,
            Some(vec![b.clone()]),
            Some(vec![other.clone(), b.clone()]),
        ]
        .into_iter();
        let mut watch = PortWatch::new(
            vec![a.clone()],
            Box::new(move || looks.next().expect("few looks")),
        );
        let mut at = |t_s: f64| watch.poll(Stamp::from_seconds(t_s));
        assert_eq!(at(0.0), []);
        assert_eq!(at(0.5), [], "not yet time");
        assert_eq!(at(1.0), [PortChange::Appeared(b)]);
        assert_eq!(at(2.0), [], "the look failed");
        assert_eq!(at(3.0), [PortChange::Gone(a)]);
        let back = at(4.0);
        assert_eq!(back, [PortChange::Appeared(other)]);
        assert_eq!(
            back[0].text(),
            "Serial port /dev/ttyACM0 (Arduino Mega 2560 2) appeared."
        );
    }

    #[test]
    fn ports_are_told_by_what_is_behind_them() {
        let usb = |product: Option<&str>| {
            SerialPortType::UsbPort(serialport::UsbPortInfo {
                vid: 0x2341,
                pid: 0x42,
                serial_number: product.map(|_| "7573".to_owned()),
                manufacturer: None,
                product: product.map(str::to_owned),
                #[cfg(not(unix))]
                interface: None,
            })
        };
        let found = |name: &str, port_type| SerialPortInfo {
            port_name: name.into(),
            port_type,
        };
        let ports = described(vec![
            found("/dev/ttyUSB1", usb(None)),
            found("/dev/ttyACM0", usb(Some("Mega 2560"))),
            found("/dev/ttyS0", SerialPortType::Unknown),
        ]);
        let told: Vec<_> = ports
            .iter()
            .map(|p| (p.name.as_str(), p.what.as_str()))
            .collect();
        let wanted = [
            ("/dev/ttyACM0", "Mega 2560 7573"),
            ("/dev/ttyS0", ""),
            ("/dev/ttyUSB1", "USB 2341:0042"),
        ];
        assert_eq!(told, wanted);
    }

    /// The bridges' numbers belong to modems and instruments, too.
    #[test]
    fn the_rules_for_ports_give_away_no_bridge_by_its_kind_alone() {
        let rules = include_str!("../../assets/package/70-springtwin.rules");
        let lines = rules.lines().filter(|l| l.contains("uaccess"));
        let (out, active): (Vec<_>, Vec<_>) = lines.partition(|l| l.starts_with('#'));
        for line in active {
            let is_board = ["2341", "2a03"].iter().any(|v| line.contains(v));
            let is_named = ["ATTRS{product}==", "ATTRS{serial}=="]
                .iter()
                .any(|by| line.contains(by));
            assert!(is_board || is_named, "{line}");
        }
        for bridge in ["1a86", "0403", "10c4"] {
            assert!(out.iter().any(|l| l.contains(bridge)), "{bridge}");
        }
    }
}
