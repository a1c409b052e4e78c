//! Motion capture that is received and not used: from whom, which objects, and what to do about it.

use std::net::IpAddr;

use super::mocap::Received;
use super::wire::objects::PORT;
use crate::signal::Stamp;

/// Rates are means over this time, s.
const PERIOD_S: f64 = 1.0;

/// Compares what is received from second to second.
#[derive(Debug)]
pub struct MocapWatch {
    /// The object whose pose is wanted.
    object: String,
    before: Received,
    since: Stamp,
    /// What is ignored at present, as one sentence.
    present: Option<String>,
    /// The kinds that have been reported.
    reported: Vec<Ignored>,
}

/// A kind of motion capture that is not used.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Ignored {
    /// The sender is not on the list.
    Sender(IpAddr),
    /// The datagrams are something else.
    Malformed,
    /// The object is not among those that are sent.
    Objects(Vec<String>),
}

impl Ignored {
    fn text(&self, per_s: f64, wanted: &str) -> String {
        match self {
            Self::Sender(from) => format!(
                "Motion capture: {per_s:.0} packets/s from {from} ignored: add --mocap-from {from}."
            ),
            Self::Malformed => format!(
                "Motion capture: {per_s:.0} packets/s not understood: send Tracker's UDP object stream (port {PORT}) here."
            ),
            Self::Objects(names) => format!(
                "Motion capture: {per_s:.0} packets/s without the object {wanted:?}, with {}: rename it in Tracker, or \
                 register it with calibrate mocap --object NAME and start with --registration.",
                list(names)
            ),
        }
    }
}

fn list(names: &[String]) -> String {
    let quoted: Vec<_> = names.iter().map(|n| format!("{n:?}")).collect();
    match quoted.is_empty() {
        true => "no object".to_owned(),
        false => quoted.join(", "),
    }
}

impl MocapWatch {
    /// For somebody who wants the poses of `object`.
    pub fn new(object: &str) -> Self {
        Self {
            object: object.to_owned(),
            before: Received::default(),
            since: Stamp::ZERO,
            present: None,
            reported: Vec::new(),
        }
    }

    /// What is ignored at present, as one sentence; `None`: nothing.
    pub fn present(&self) -> Option<&String> {
        self.present.as_ref()
    }

    /// Whether it is time to look at what was received.
    pub fn is_due(&self, now: Stamp) -> bool {
        now.since(self.since) >= PERIOD_S
    }

    /// Looks at what was received up to `now`; one sentence about a kind that was not ignored before, else `None`.
    pub fn look(&mut self, now: Stamp, received: Received) -> Option<String> {
        let for_s = now.since(self.since).max(PERIOD_S);
        let found = self.found(&received);
        self.since = now;
        self.before = received;
        self.present = None;
        let (kind, n) = found?;
        let text = kind.text(n as f64 / for_s, &self.object);
        self.present = Some(text.clone());
        let is_new = !self.reported.contains(&kind);
        is_new.then(|| {
            self.reported.push(kind);
            text
        })
    }

    /// What was ignored most since the look before, if the object was not received.
    fn found(&self, received: &Received) -> Option<(Ignored, u64)> {
        let new = |now: u64, before: Option<u64>| now.saturating_sub(before.unwrap_or(0));
        let before = &self.before;
        let objects: Vec<&String> = received
            .objects
            .iter()
            .filter(|(name, n)| new(*n, before.of_object(name)) > 0)
            .map(|(name, _)| name)
            .collect();
        if objects.contains(&&self.object) {
            return None;
        }
        let used = new(received.counts.used, Some(before.counts.used));
        let malformed = new(received.counts.malformed, Some(before.counts.malformed));
        let senders = received.foreign.iter().map(|(from, n)| {
            let n = new(*n, before.of_sender(*from));
            (Ignored::Sender(*from), n)
        });
        let others = objects.into_iter().cloned().collect();
        let all = senders.chain([
            (Ignored::Objects(others), used),
            (Ignored::Malformed, malformed),
        ]);
        all.filter(|(_, n)| *n > 0).max_by_key(|(_, n)| *n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::mocap::MocapCounts;

    fn received(
        foreign: &[(IpAddr, u64)],
        objects: &[(&str, u64)],
        [used, malformed]: [u64; 2],
    ) -> Received {
        Received {
            counts: MocapCounts {
                used,
                malformed,
                foreign: foreign.iter().map(|f| f.1).sum(),
                ..MocapCounts::default()
            },
            foreign: foreign.to_vec(),
            objects: objects.iter().map(|(o, n)| ((*o).to_owned(), *n)).collect(),
        }
    }

    #[test]
    fn what_is_ignored_is_named_with_its_rate_and_reported_once() {
        let from = IpAddr::from([192, 168, 10, 1]);
        let mut watch = MocapWatch::new("end_pad");
        let at = Stamp::from_seconds;
        assert!(watch.is_due(at(10.0)));
        assert_eq!(watch.look(at(10.0), received(&[], &[], [0, 0])), None);
        assert!(!watch.is_due(at(10.9)));
        let first = watch.look(at(11.0), received(&[(from, 120)], &[], [0, 0]));
        let wanted = "Motion capture: 120 packets/s from 192.168.10.1 ignored: add --mocap-from 192.168.10.1.";
        assert_eq!(first.as_deref(), Some(wanted));
        let next = watch.look(at(12.0), received(&[(from, 220)], &[], [0, 0]));
        assert_eq!(next, None);
        assert!(watch.present().is_some_and(|t| t.contains("100 packets/s")));
        // Now it is let in, and sends other objects.
        let others = [("wand", 100), ("tip", 100)];
        let third = watch.look(at(13.0), received(&[(from, 220)], &others, [100, 0]));
        let third = third.expect("reported");
        assert!(
            third.contains("without the object \"end_pad\", with \"wand\", \"tip\""),
            "{third}"
        );
        let malformed = watch.look(at(14.0), received(&[(from, 220)], &others, [100, 7]));
        assert!(malformed.is_some_and(|t| t.contains("7 packets/s not understood")));
        // The object comes, beside others and a sender that is not wanted.
        let all = [("wand", 200), ("tip", 200), ("end_pad", 100)];
        assert_eq!(
            watch.look(at(15.0), received(&[(from, 330)], &all, [200, 7])),
            None
        );
        assert_eq!(watch.present(), None);
    }
}
