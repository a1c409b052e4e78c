//! Ports that are gone: why they do not come back.

use std::path::Path;

use super::ports::PortInfo;

/// Why the ports of a link that are gone do not open.
#[derive(Debug, Default)]
pub(super) struct Absence {
    /// The ports that there were when the link was opened.
    at_opening: Vec<PortInfo>,
    /// The reason of the latest try.
    reason: Option<String>,
    /// The reason that has been reported.
    reported: Option<String>,
}

impl Absence {
    /// For a link that is opened while there are these ports.
    pub fn new(at_opening: Vec<PortInfo>) -> Self {
        Self {
            at_opening,
            ..Self::default()
        }
    }

    /// The reason, if it is another than that the port is gone; else `None`.
    pub fn reason(&self) -> Option<&String> {
        self.reason.as_ref()
    }

    /// The ports are open.
    pub fn ends(&mut self) {
        (self.reason, self.reported) = (None, None);
    }

    /// Notes that the port `name` has not opened for this reason, while there are `present`; what there is to report, if
    /// anything. Rights come a moment after a device: only what has kept two tries from succeeding is reported, once. Else
    /// `None`.
    pub fn note(&mut self, name: &str, refused: &str, present: &[PortInfo]) -> Option<String> {
        let is_there = Path::new(name).exists() || present.iter().any(|p| p.name == name);
        let reason = match is_there {
            true => Some(refused.to_owned()),
            false => self.moved(name, present),
        };
        let before = std::mem::replace(&mut self.reason, reason);
        let new = self.reason.as_ref().filter(|r| before.as_ref() == Some(r));
        let new = new.filter(|r| self.reported.as_ref() != Some(r))?;
        self.reported = Some(new.clone());
        self.reported.clone()
    }

    /// Where the board of a port is that has got another name.
    fn moved(&self, name: &str, present: &[PortInfo]) -> Option<String> {
        let device = std::fs::canonicalize(name).ok();
        let is_it = |p: &&PortInfo| p.name == name || device.as_deref() == Some(Path::new(&p.name));
        let was = self.at_opening.iter().find(is_it)?;
        let serial = was.usb_serial.as_ref()?;
        // Some makers give all their devices the same number.
        let is_new = |p: &&PortInfo| !self.at_opening.contains(p);
        let now = present
            .iter()
            .filter(is_new)
            .find(|p| p.usb_serial.as_ref() == Some(serial))?;
        Some(format!(
            "its board (USB serial number {serial}) is now at {}: connect to that port. The names in \
             /dev/serial/by-id do not change.",
            now.name
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn port(name: &str, serial: Option<&str>) -> PortInfo {
        PortInfo {
            name: name.to_owned(),
            what: String::new(),
            usb_serial: serial.map(str::to_owned),
        }
    }

    #[test]
    fn a_board_under_another_name_is_found_by_its_serial_number() {
        let was = port("/dev/springtwin-ACM0", Some("7573"));
        let twin = port("/dev/springtwin-ACM5", Some("7573"));
        let mut absence = Absence::new(vec![was.clone(), twin.clone()]);
        let present = [twin, port("/dev/springtwin-ACM1", Some("7573"))];
        let mut note = |present: &[PortInfo]| absence.note(&was.name, "No such file", present);
        assert_eq!(note(&present[..1]), None, "it is only gone");
        assert_eq!(note(&present[..1]), None, "it is only gone");
        assert_eq!(note(&present), None, "seen once");
        let reported = note(&present).expect("seen twice");
        assert!(
            reported.contains("7573") && reported.contains("now at /dev/springtwin-ACM1"),
            "{reported}"
        );
        assert_eq!(note(&present), None, "reported before");
        assert_eq!(absence.reason(), Some(&reported));
        absence.ends();
        assert_eq!(absence.reason(), None);
    }

    #[test]
    fn a_port_that_is_there_and_does_not_open_is_reported_with_the_reason() {
        let there = port("/dev/springtwin-ACM0", None);
        let mut absence = Absence::new(vec![there.clone()]);
        let present = [there.clone()];
        let mut note = |why: &str| absence.note(&there.name, why, &present);
        assert_eq!(
            note("no rights"),
            None,
            "the system hands them out in a moment"
        );
        assert_eq!(note("in use by minicom"), None);
        assert_eq!(
            note("in use by minicom"),
            Some("in use by minicom".to_owned())
        );
        assert_eq!(note("in use by minicom"), None);
    }
}
