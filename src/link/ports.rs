//! The serial ports that the system knows, as they come and go.

use serialport::SerialPortType;

use crate::signal::Stamp;

/// Time between two looks, s.
const PERIOD_S: f64 = 1.0;

/// A serial port.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PortInfo {
    /// What it is opened by.
    pub name: String,
    /// What is behind it, as far as the system tells; may be empty.
    pub what: String,
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
pub fn list() -> Vec<PortInfo> {
    let found = serialport::available_ports().unwrap_or_default();
    let mut ports: Vec<PortInfo> = found
        .into_iter()
        .map(|p| PortInfo {
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

/// Watches the list; looks at most once a second.
pub struct PortWatch {
    list: Box<dyn FnMut() -> Vec<PortInfo> + Send>,
    known: Vec<PortInfo>,
    next: Stamp,
}

impl Default for PortWatch {
    fn default() -> Self {
        Self::new(Box::new(list))
    }
}

impl PortWatch {
    /// Watches what `list` gives; what it gives now is known.
    pub fn new(mut list: Box<dyn FnMut() -> Vec<PortInfo> + Send>) -> Self {
        Self {
            known: list(),
            list,
            next: Stamp::ZERO,
        }
    }

    /// What is known to be there.
    pub fn known(&self) -> &[PortInfo] {
        &self.known
    }

    /// What has come and gone since the last look, if it is time for one.
    pub fn poll(&mut self, now: Stamp) -> Vec<PortChange> {
        if now < self.next {
            return Vec::new();
        }
        self.next = now.plus(PERIOD_S);
        let fresh = (self.list)();
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
        }
    }

    #[test]
    fn ports_come_and_go_and_a_swap_behind_one_name_is_both() {
        let a = port("/dev/ttyACM0", "Arduino Mega 2560 1");
        let b = port("/dev/ttyACM1", "");
        let other = port("/dev/ttyACM0", "Arduino Mega 2560 2");
        let mut looks = vec![
            vec![a.clone()],
            vec![a.clone()],
            vec![a.clone(), b.clone()],
            vec![b.clone()],
            vec![other.clone(), b.clone()],
        ]
        .into_iter();
        let mut watch = PortWatch::new(Box::new(move || looks.next().expect("few looks")));
        let mut at = |t_s: f64| watch.poll(Stamp::from_seconds(t_s));
        assert_eq!(at(0.0), []);
        assert_eq!(at(0.5), [], "not yet time");
        assert_eq!(at(1.0), [PortChange::Appeared(b)]);
        assert_eq!(at(2.0), [PortChange::Gone(a)]);
        let back = at(3.0);
        assert_eq!(back, [PortChange::Appeared(other)]);
        assert_eq!(
            back[0].text(),
            "Serial port /dev/ttyACM0 (Arduino Mega 2560 2) appeared."
        );
    }

    /// Whatever this computer has: the list is in order and without doubles.
    #[test]
    fn the_list_of_this_computer_is_sorted() {
        let ports = list();
        assert!(ports.windows(2).all(|w| w[0] < w[1]), "{ports:?}");
    }
}
