//! The messages of a recording, sent to a viewer that runs.

use std::net::SocketAddr;
use std::pin::pin;
use std::task::{Context, Waker};
use std::time::Duration;

use rerun::external::re_grpc_client::write::{Client, ClientConnectionState, Options};
use rerun::external::re_uri::ProxyUri;
use rerun::log::LogMsg;
use rerun::{StoreId, StoreKind};

use super::blueprint::Shown;
use super::rows::{Rows, opening};
use super::schema;
use crate::recording::RecordingMeta;
use crate::recording::patience::{Broken, Waiting};
use crate::signal::{Snapshot, Stamp};

/// Session time after which a batch is sent, ns.
const BATCH_NS: i64 = 200_000_000;

/// A connection to a viewer. At most a hundred messages wait in it; dropping it waits until the viewer
/// has taken them or is gone.
pub(in crate::recording) struct LiveSink {
    address: SocketAddr,
    client: Client,
    rows: Rows,
    /// What comes before all rows, until it is sent.
    opening: Vec<LogMsg>,
}

impl LiveSink {
    /// Begins to connect.
    pub(in crate::recording) fn connect(
        address: SocketAddr,
        mut meta: RecordingMeta,
    ) -> Result<Self, String> {
        let random = StoreId::random(StoreKind::Recording, schema::APPLICATION);
        meta.id = random.recording_id().as_str().to_owned();
        let opening = opening(&meta, 1, Shown::Live, None)
            .map_err(|e| format!("The stream to the Rerun viewer cannot begin: {e}."))?;
        let uri: ProxyUri = format!("rerun+http://{address}/proxy")
            .parse()
            .map_err(|e| format!("{address} is no address of a Rerun viewer: {e}."))?;
        let options = Options {
            connect_timeout_on_flush: Duration::ZERO,
            ..Options::default()
        };
        Ok(Self {
            address,
            client: Client::new(uri, options),
            rows: Rows::new(&meta, Shown::Live, BATCH_NS),
            opening,
        })
    }

    /// Takes a snapshot; returns whether a batch is due.
    pub(in crate::recording) fn push(&mut self, snapshot: &Snapshot) -> bool {
        self.rows.push(snapshot)
    }

    /// Takes one line of the event log.
    pub(in crate::recording) fn event(&mut self, stamp: Stamp, text: &str) {
        self.rows.event(stamp, text);
    }

    /// Sends what is queued and returns the number of snapshots, or why the stream is over.
    pub(in crate::recording) fn flush(&mut self, waiting: &mut Waiting<'_>) -> Result<u64, Broken> {
        let address = self.address;
        loop {
            match self.client.status() {
                ClientConnectionState::Connected => break,
                ClientConnectionState::Disconnected(_) => return Err(self.gone()),
                ClientConnectionState::Connecting { .. } if waiting.goes_on() => {}
                ClientConnectionState::Connecting { .. } => {
                    return Err(Broken::Away(format!(
                        "The Rerun viewer at {address} does not answer: start it with `rerun --bind 127.0.0.1 --port {}`.",
                        address.port()
                    )));
                }
            }
        }
        let rows = self.rows.waiting() as u64;
        let mut messages = std::mem::take(&mut self.opening);
        messages.extend(self.rows.take(false).map_err(|e| {
            Broken::Failed(format!("The stream to the Rerun viewer broke off: {e}."))
        })?);
        for message in messages {
            self.send(message, waiting)?;
            waiting.begin_again();
        }
        Ok(rows)
    }

    /// Sends one message, waiting for the queue as long as `waiting` allows. The client's own blocking call
    /// would wait for ever.
    fn send(&self, message: LogMsg, waiting: &mut Waiting<'_>) -> Result<(), Broken> {
        let mut sending = pin!(self.client.send_async(message));
        let mut context = Context::from_waker(Waker::noop());
        while sending.as_mut().poll(&mut context).is_pending() {
            if !waiting.goes_on() {
                return Err(Broken::Away(format!(
                    "The Rerun viewer at {} has taken nothing for a while: end it if it hangs.",
                    self.address
                )));
            }
        }
        match self.client.status() {
            ClientConnectionState::Disconnected(_) => Err(self.gone()),
            _ => Ok(()),
        }
    }

    fn gone(&self) -> Broken {
        Broken::Away(format!("The Rerun viewer at {} went away.", self.address))
    }
}
