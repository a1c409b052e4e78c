//! Values of a bag over time, by their topic and field.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::definition::Definition;
use super::records::{End, Record, damaged, each_record, refuse};
use super::value::{FieldPath, Found, Value};
use crate::recording::{RecordingError, SizeLimit};

/// How far the length of a quaternion may be off 1.
const UNIT: f64 = 0.05;

/// Times of messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Clock {
    /// Of the header, where it has one that is set; else when the bag received the message.
    #[default]
    Header,
    /// When the bag received the message.
    Log,
}

/// What is wanted of a topic.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    pub(super) topic: String,
    pub(super) path: FieldPath,
    pub(super) what: What,
}

/// Numbers that belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// One.
    Number,
    /// A quaternion x, y, z, w.
    Turn,
    /// A position, m, and a quaternion.
    Place,
}

impl What {
    fn width(self) -> usize {
        match self {
            Self::Number => 1,
            Self::Turn => 4,
            Self::Place => 7,
        }
    }
}

impl Wanted {
    /// By the name of topic and field: `/imu/data.orientation`.
    ///
    /// # Errors
    /// A sentence.
    pub(super) fn parse(text: &str, what: What) -> Result<Self, String> {
        let (topic, path) = text.split_once('.').unwrap_or((text, ""));
        if !topic.starts_with('/') || topic.len() < 2 {
            return Err(format!(
                "'{text}' names no topic: write topic and field, such as /imu/data.orientation"
            ));
        }
        Ok(Self {
            topic: topic.to_owned(),
            path: FieldPath::parse(path)?,
            what,
        })
    }
}

/// The values of one field. Those of message `k` are `values[k * width..(k + 1) * width]`.
#[derive(Clone, Debug, Default)]
pub(super) struct Series {
    width: usize,
    /// Rising, ns, once [`Series::in_order`] has passed.
    pub(super) stamps_ns: Vec<i64>,
    log_ns: Vec<u64>,
    values: Vec<f64>,
    /// Messages by their header's stamp, and by the bag's time.
    pub(super) by_clock: [u64; 2],
    /// The bag's time less the header's stamp of the message where it is smallest, s; `None` without a header.
    pub(super) offset_s: Option<f64>,
    /// Messages that were left out because their time was that of the message before.
    pub(super) repeated: u64,
}

impl Series {
    /// Number of messages.
    pub(super) fn len(&self) -> usize {
        self.stamps_ns.len()
    }

    /// The values of message `k`.
    pub(super) fn at(&self, k: usize) -> &[f64] {
        &self.values[k * self.width..(k + 1) * self.width]
    }

    /// Brings the messages into the order in which the bag received them, and takes out those whose stamp is that before.
    ///
    /// # Errors
    /// The end of a sentence that begins with the topic: where its clock jumps back.
    pub(super) fn in_order(&mut self) -> Result<(), String> {
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_by_key(|k| self.log_ns[*k]);
        let (mut stamps_ns, mut values) = (Vec::new(), Vec::new());
        for (n, k) in order.into_iter().enumerate() {
            let stamp = self.stamps_ns[k];
            match stamps_ns.last() {
                Some(last) if stamp == *last => {
                    self.repeated += 1;
                    continue;
                }
                Some(last) if stamp < *last => {
                    return Err(format!(
                        "its clock jumps back by {:.3} s at message {}: cut the bag there, or set clock = \"log\"",
                        (*last - stamp) as f64 * 1e-9,
                        n + 1
                    ));
                }
                _ => {}
            }
            stamps_ns.push(stamp);
            values.extend_from_slice(self.at(k));
        }
        self.stamps_ns = stamps_ns;
        self.values = values;
        self.log_ns = Vec::new();
        Ok(())
    }
}

/// A topic of a bag.
#[derive(Clone, Debug, Default)]
pub(super) struct TopicInfo {
    /// Type of its messages.
    pub(super) kind: String,
    pub(super) messages: u64,
}

/// What was read of a bag.
pub(super) struct Collected {
    /// In the order of what was wanted.
    pub(super) series: Vec<Series>,
    pub(super) topics: BTreeMap<String, TopicInfo>,
    /// Of the records of one name.
    pub(super) metadata: Option<BTreeMap<String, String>>,
    pub(super) end: End,
}

impl Collected {
    /// The names of the topics, for people.
    pub(super) fn names_text(&self) -> String {
        if self.topics.is_empty() {
            return "it has no topics".to_owned();
        }
        let all: Vec<&str> = self.topics.keys().map(String::as_str).collect();
        format!("its topics are {}", all.join(", "))
    }

    /// The topics with their types and numbers of messages, for people.
    pub(super) fn topics_text(&self) -> String {
        if self.topics.is_empty() {
            return "it has no topics".to_owned();
        }
        let line =
            |(name, t): (&String, &TopicInfo)| format!("{name} ({}, {})", t.kind, t.messages);
        let all: Vec<String> = self.topics.iter().map(line).collect();
        format!("its topics are {}", all.join(", "))
    }
}

/// A schema of a bag, read when a message needs it.
struct Schema {
    name: String,
    encoding: String,
    text: Vec<u8>,
    definition: Option<Definition>,
}

struct Channel {
    schema: u16,
    topic: String,
    encoding: String,
    /// What is wanted of it.
    wanted: Vec<usize>,
}

/// Reads what is wanted of a bag, and the metadata of one name.
///
/// # Errors
/// As [`each_record`]; [`RecordingError::Session`] with topic and message for one that is not understood;
/// [`RecordingError::TooLarge`].
pub(super) fn collect(
    source: impl Read,
    path: &Path,
    wanted: &[Wanted],
    clock: Clock,
    metadata_name: &str,
) -> Result<Collected, RecordingError> {
    let mut reader = Reader {
        path,
        wanted,
        clock,
        limit: SizeLimit::of_memory(),
        kept: 0,
        schemas: BTreeMap::new(),
        channels: BTreeMap::new(),
        out: Collected {
            series: wanted
                .iter()
                .map(|w| Series {
                    width: w.what.width(),
                    ..Series::default()
                })
                .collect(),
            topics: BTreeMap::new(),
            metadata: None,
            end: End::Whole,
        },
    };
    let end = each_record(source, path, &mut |record| match record {
        Record::Metadata { name, texts } => {
            if name == metadata_name {
                reader.out.metadata = Some(texts);
            }
            Ok(())
        }
        Record::Schema {
            id,
            name,
            encoding,
            text,
        } => reader.schema(id, name, encoding, text),
        Record::Channel {
            id,
            schema,
            topic,
            encoding,
        } => reader.channel(id, schema, topic, encoding),
        Record::Message {
            channel,
            log_ns,
            bytes,
        } => reader.message(channel, log_ns, bytes),
    })?;
    if end == End::Cut && reader.out.topics.is_empty() {
        let text =
            "the file ends before its first message: copy it again from where it was recorded";
        return Err(refuse(path, text));
    }
    reader.out.end = end;
    Ok(reader.out)
}

struct Reader<'a> {
    path: &'a Path,
    wanted: &'a [Wanted],
    clock: Clock,
    limit: SizeLimit,
    /// Numbers that are kept.
    kept: u64,
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Channel>,
    out: Collected,
}

impl Reader<'_> {
    /// A schema; the same may come again.
    fn schema(
        &mut self,
        id: u16,
        name: String,
        encoding: String,
        text: &[u8],
    ) -> Result<(), RecordingError> {
        match self.schemas.get(&id) {
            Some(known) if known.name == name && known.text == text => return Ok(()),
            Some(_) => return Err(damaged(self.path, &format!("schema {id} is there twice"))),
            None => {}
        }
        self.kept += text.len() as u64 / 8;
        self.check_memory()?;
        let schema = Schema {
            name,
            encoding,
            text: text.to_owned(),
            definition: None,
        };
        self.schemas.insert(id, schema);
        Ok(())
    }

    fn channel(
        &mut self,
        id: u16,
        schema: u16,
        topic: String,
        encoding: String,
    ) -> Result<(), RecordingError> {
        match self.channels.get(&id) {
            Some(known) if known.topic == topic && known.schema == schema => return Ok(()),
            Some(_) => return Err(damaged(self.path, &format!("channel {id} is there twice"))),
            None => {}
        }
        let kind = self.schemas.get(&schema).map(|s| s.name.clone());
        let info = TopicInfo {
            kind: kind.unwrap_or_else(|| "no schema".to_owned()),
            messages: 0,
        };
        self.out.topics.entry(topic.clone()).or_insert(info);
        let of_topic = |(i, w): (usize, &Wanted)| (w.topic == topic).then_some(i);
        let wanted = self.wanted.iter().enumerate().filter_map(of_topic);
        let channel = Channel {
            schema,
            wanted: wanted.collect(),
            topic,
            encoding,
        };
        self.channels.insert(id, channel);
        Ok(())
    }

    fn message(&mut self, id: u16, log_ns: u64, bytes: &[u8]) -> Result<(), RecordingError> {
        let Some(channel) = self.channels.get(&id) else {
            return Err(damaged(
                self.path,
                &format!("a message is of channel {id}, which is not there"),
            ));
        };
        let info = self.out.topics.entry(channel.topic.clone()).or_default();
        info.messages += 1;
        if channel.wanted.is_empty() {
            return Ok(());
        }
        let refuse = |text: String| refuse(self.path, &format!("{}: {text}", channel.topic));
        let Some(schema) = self.schemas.get_mut(&channel.schema) else {
            return Err(refuse(
                "its messages have no schema: record them with their definitions".to_owned(),
            ));
        };
        if channel.encoding != "cdr" || schema.encoding != "ros2msg" {
            return Err(refuse(format!(
                "its messages are encoded as {} with {} definitions, and cdr with ros2msg is read: record it with ROS 2, or convert the bag",
                channel.encoding, schema.encoding
            )));
        }
        let definition = match &mut schema.definition {
            Some(known) => known,
            none => {
                let read = Definition::parse(&schema.name, &schema.text).map_err(&refuse)?;
                none.insert(read)
            }
        };
        let at = format!("message {}", info.messages);
        let value = Value::decode(definition, bytes)
            .map_err(|e| refuse(format!("{at} does not fit its definition: {e}")))?;
        for i in &channel.wanted {
            let (wanted, series) = (&self.wanted[*i], &mut self.out.series[*i]);
            let found = wanted.path.find(&value).map_err(&refuse)?;
            let Some(found) = found else {
                continue;
            };
            let numbers = numbers(&found, wanted.what).map_err(|e| refuse(format!("{at}: {e}")))?;
            let Some((numbers, width)) = numbers else {
                continue;
            };
            // A header whose stamp is 0 was not filled in.
            let header = found.stamp_ns.filter(|ns| *ns != 0);
            let stamp = match (self.clock, header) {
                (Clock::Header, Some(ns)) => {
                    series.by_clock[0] += 1;
                    ns
                }
                _ => {
                    series.by_clock[1] += 1;
                    i64::try_from(log_ns)
                        .map_err(|_| refuse(format!("{at} is of no year that there is")))?
                }
            };
            if let Some(header) = header {
                let offset_s = (log_ns as f64 - header as f64) * 1e-9;
                let known = series.offset_s.filter(|s| s.abs() <= offset_s.abs());
                series.offset_s = known.or(Some(offset_s));
            }
            series.stamps_ns.push(stamp);
            series.log_ns.push(log_ns);
            series.values.extend_from_slice(&numbers[..width]);
            self.kept += 2 + width as u64;
        }
        self.check_memory()
    }

    fn check_memory(&self) -> Result<(), RecordingError> {
        // What grows is twice as large while it is copied.
        self.limit.check_count(self.path, self.kept, "values", 16)
    }
}

/// What a message has of what is wanted; `None` for a value that is marked as missing.
fn numbers(found: &Found<'_, '_>, what: What) -> Result<Option<([f64; 7], usize)>, String> {
    let mut out = [f64::NAN; 7];
    let width = what.width();
    match what {
        What::Number => out[0] = found.value.number()?,
        What::Turn => out[..4].copy_from_slice(&found.value.turn()?),
        What::Place => out = found.value.place()?,
    }
    if what == What::Number {
        return Ok(out[0].is_finite().then_some((out, width)));
    }
    // sensor_msgs/Imu: without an orientation the first covariance is -1.
    if let Some(Value::Numbers(covariance)) = found.within.field("orientation_covariance")
        && covariance.get(0) == Some(-1.0)
    {
        return Ok(None);
    }
    let length = out[width - 4..width]
        .iter()
        .map(|x| x * x)
        .sum::<f64>()
        .sqrt();
    // Bodies that are not seen are all zeros in some programs.
    if out[..width].iter().any(|x| !x.is_finite()) || length == 0.0 {
        return Ok(None);
    }
    match (length - 1.0).abs() <= UNIT {
        true => Ok(Some((out, width))),
        false => Err(format!("a quaternion of length {length:.3}")),
    }
}
