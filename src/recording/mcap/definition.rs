//! Definitions of ROS 2 messages, as an MCAP file holds them (`ros2msg`): the text of the message, then of each message in it
//! behind a line of `=` and `MSG: package/Name`.

use super::cdr::Number;

/// Longest text of a definition, bytes.
const TEXT_MAX: usize = 1 << 20;
/// Messages within messages, levels.
const DEPTH_MAX: usize = 16;

/// A message with those that it consists of.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Definition {
    /// The message itself first.
    pub(super) messages: Vec<Message>,
}

/// A type of message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Message {
    /// Name with its package, `sensor_msgs/Imu`.
    pub(super) name: String,
    /// In the order of the encoding.
    pub(super) fields: Vec<Field>,
}

impl Message {
    /// Names of the fields, for people.
    pub(super) fn field_names(&self) -> String {
        let names: Vec<&str> = self.fields.iter().map(|f| f.name.as_str()).collect();
        names.join(", ")
    }
}

/// A field of a message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) shape: Shape,
}

/// What a field holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Number(Number),
    Text,
    /// The message of this place in the definition.
    Message(usize),
}

/// How many values a field holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    One,
    Array(usize),
    Sequence,
}

impl Definition {
    /// Reads the definition of the message `name`.
    ///
    /// # Errors
    /// A sentence: what is not understood, and in which message.
    pub(super) fn parse(name: &str, text: &[u8]) -> Result<Self, String> {
        if text.len() > TEXT_MAX {
            return Err(format!("its definition has {} bytes", text.len()));
        }
        let text = std::str::from_utf8(text).map_err(|_| "its definition is no UTF-8")?;
        let mut parts: Vec<(String, Vec<&str>)> = vec![(short(name), Vec::new())];
        let mut begins = false;
        for line in text.lines().map(str::trim) {
            if line.len() >= 3 && line.bytes().all(|b| b == b'=') {
                begins = true;
                continue;
            }
            if let Some(name) = line.strip_prefix("MSG:").filter(|_| begins) {
                parts.push((short(name.trim()), Vec::new()));
            } else if let Some((_, lines)) = parts.last_mut() {
                lines.push(line);
            }
            begins = false;
        }
        let names: Vec<&str> = parts.iter().map(|(name, _)| name.as_str()).collect();
        let messages = parts.iter().map(|(name, lines)| {
            let message = message(name, lines, &names);
            message.map_err(|e| format!("{name}: {e}"))
        });
        let definition = Self {
            messages: messages.collect::<Result<_, _>>()?,
        };
        let mut heights = vec![None; definition.messages.len()];
        definition.height(0, 0, &mut heights)?;
        Ok(definition)
    }

    /// Levels of messages below one, which stands at a level itself.
    fn height(
        &self,
        of: usize,
        level: usize,
        known: &mut [Option<usize>],
    ) -> Result<usize, String> {
        let deep = || {
            format!(
                "{}: messages within messages are read up to {DEPTH_MAX} levels",
                self.messages[of].name
            )
        };
        let mut height = known[of].unwrap_or(0);
        if known[of].is_none() && level <= DEPTH_MAX {
            for field in &self.messages[of].fields {
                if let Kind::Message(inner) = field.kind {
                    height = height.max(1 + self.height(inner, level + 1, known)?);
                }
            }
            known[of] = Some(height);
        }
        match level + height <= DEPTH_MAX {
            true => Ok(height),
            false => Err(deep()),
        }
    }
}

/// `package/Name` of `package/msg/Name`.
fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

fn message(name: &str, lines: &[&str], names: &[&str]) -> Result<Message, String> {
    let fields = lines.iter().map(|line| field(name, line, names));
    let fields: Result<Vec<Option<Field>>, String> = fields.collect();
    let mut fields: Vec<Field> = fields?.into_iter().flatten().collect();
    if fields.is_empty() {
        // A message without a field has one byte.
        fields.push(Field {
            name: "structure_needs_at_least_one_member".to_owned(),
            kind: Kind::Number(Number::U8),
            shape: Shape::One,
        });
    }
    Ok(Message {
        name: name.to_owned(),
        fields,
    })
}

/// The field of a line; `None` for one without, and for a constant.
fn field(message: &str, line: &str, names: &[&str]) -> Result<Option<Field>, String> {
    let line = line.split('#').next().unwrap_or_default();
    let mut words = line.split_whitespace();
    let Some(of) = words.next() else {
        return Ok(None);
    };
    let name = words
        .next()
        .ok_or_else(|| format!("'{line}' is no field: a type and a name"))?;
    let is_constant = name.contains('=') || words.next().is_some_and(|w| w.starts_with('='));
    if is_constant {
        return Ok(None);
    }
    let (base, shape) = match of.split_once('[') {
        None => (of, Shape::One),
        Some((base, inside)) => {
            let inside = inside
                .strip_suffix(']')
                .ok_or_else(|| format!("'{of}' is no type"))?;
            let is_sequence = inside.is_empty() || inside.starts_with("<=");
            let shape = match is_sequence {
                true => Shape::Sequence,
                false => Shape::Array(inside.parse().map_err(|_| format!("'{of}' is no type"))?),
            };
            (base, shape)
        }
    };
    let base = base.split("<=").next().unwrap_or(base);
    let kind = match base {
        "string" => Kind::Text,
        "wstring" => return Err(format!("wstring (of {name}) is not read")),
        _ => match Number::named(base) {
            Some(number) => Kind::Number(number),
            None => Kind::Message(place(message, base, names)?),
        },
    };
    Ok(Some(Field {
        name: name.to_owned(),
        kind,
        shape,
    }))
}

/// The place of a message that another one names.
fn place(message: &str, base: &str, names: &[&str]) -> Result<usize, String> {
    let package = message.split('/').next().unwrap_or_default();
    let full = match base {
        "Header" => "std_msgs/Header".to_owned(),
        _ if base.contains('/') => short(base),
        _ => format!("{package}/{base}"),
    };
    let found = names.iter().position(|n| *n == full);
    found.ok_or_else(|| format!("the definition of {full} is missing"))
}
