//! The values of a message, and how a path finds one of them.
//!
//! A path is names of fields with points between them: `pose.position.x`. An element is named by its number from 0 on
//! (`data[2]`), or by a text: `transforms[child_frame_id=tip]` is the element whose field is that, `position[knee]` the number
//! beside which the sequence `name` of the same message has it.

use super::cdr::{CdrReader, Numbers};
use super::definition::{Definition, Field, Kind, Message, Shape};

/// Values of one message that are kept apart.
const VALUES_MAX: usize = 1_000_000;

/// A value of a message.
#[derive(Debug)]
pub(super) enum Value<'a> {
    Number(f64),
    Text(&'a [u8]),
    /// Several numbers.
    Numbers(Numbers<'a>),
    /// Several texts or messages.
    List(Vec<Value<'a>>),
    Message(&'a Message, Vec<Value<'a>>),
}

impl<'a> Value<'a> {
    /// The message that bytes in CDR hold.
    ///
    /// # Errors
    /// The end of a sentence that begins with the message.
    pub(super) fn decode(definition: &'a Definition, bytes: &'a [u8]) -> Result<Self, String> {
        let mut decoder = Decoder {
            reader: CdrReader::new(bytes)?,
            definition,
            values: 0,
        };
        decoder.message(0)
    }

    /// The field of a message; `None` where it has none of the name.
    pub(super) fn field(&self, name: &str) -> Option<&Value<'a>> {
        let Self::Message(message, values) = self else {
            return None;
        };
        let at = message.fields.iter().position(|f| f.name == name)?;
        values.get(at)
    }

    /// A number of a message; `None` where it has none of the name.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        match self.field(name)? {
            Self::Number(x) => Some(*x),
            _ => None,
        }
    }

    /// The stamp of its header, ns; `None` without one.
    fn stamp_ns(&self) -> Option<i64> {
        let stamp = self.field("header")?.field("stamp")?;
        let [sec, nanosec] = [stamp.number("sec")?, stamp.number("nanosec")?];
        Some(sec as i64 * 1_000_000_000 + nanosec as i64)
    }

    /// What it is, for people.
    fn what(&self) -> String {
        match self {
            Self::Number(_) => "a number".to_owned(),
            Self::Text(_) => "a text".to_owned(),
            Self::Numbers(numbers) => format!("{} numbers", numbers.len()),
            Self::List(list) => format!("{} elements", list.len()),
            Self::Message(message, _) => message.name.clone(),
        }
    }
}

struct Decoder<'a> {
    reader: CdrReader<'a>,
    definition: &'a Definition,
    values: usize,
}

impl<'a> Decoder<'a> {
    /// The levels of messages are bounded by the definition.
    fn message(&mut self, place: usize) -> Result<Value<'a>, String> {
        let message = &self.definition.messages[place];
        let fields = message.fields.iter().map(|field| {
            let value = self.field(field);
            value.map_err(|e| format!("{e}, in its field {}", field.name))
        });
        Ok(Value::Message(message, fields.collect::<Result<_, _>>()?))
    }

    fn field(&mut self, field: &Field) -> Result<Value<'a>, String> {
        let n = match field.shape {
            Shape::One => return self.one(field.kind),
            Shape::Array(n) => n,
            Shape::Sequence => self.reader.length()?,
        };
        if let Kind::Number(kind) = field.kind {
            return Ok(Value::Numbers(self.reader.numbers(kind, n)?));
        }
        // Every element has a byte at least.
        if n > self.reader.left() {
            return Err(format!("it ends before {n} elements"));
        }
        let list = (0..n).map(|_| self.one(field.kind));
        Ok(Value::List(list.collect::<Result<_, _>>()?))
    }

    fn one(&mut self, kind: Kind) -> Result<Value<'a>, String> {
        self.values += 1;
        if self.values > VALUES_MAX {
            return Err(format!("it has more than {VALUES_MAX} values"));
        }
        match kind {
            Kind::Number(number) => Ok(Value::Number(self.reader.number(number)?)),
            Kind::Text => Ok(Value::Text(self.reader.text()?)),
            Kind::Message(place) => self.message(place),
        }
    }
}

/// Where a value stands in a message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FieldPath {
    text: String,
    steps: Vec<Step>,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    Field(String),
    /// From 0 on.
    Element(usize),
    /// By a field, or by a sequence beside it, and its text.
    Named(String, String),
}

/// What a path leads to.
#[derive(Debug)]
pub(super) struct Found<'v, 'a> {
    pub(super) value: FoundValue<'v, 'a>,
    /// The message that it is a field of.
    pub(super) within: &'v Value<'a>,
    /// The stamp of the nearest header around it, ns; `None` without one.
    pub(super) stamp_ns: Option<i64>,
}

/// A value, or a number of several.
#[derive(Clone, Copy, Debug)]
pub(super) enum FoundValue<'v, 'a> {
    Number(f64),
    Value(&'v Value<'a>),
}

impl FieldPath {
    /// Reads a path.
    ///
    /// # Errors
    /// A sentence.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("'{text}' is no field: write fields such as pose.position.x or data[2]");
        let mut steps = Vec::new();
        let mut rest = text;
        while !rest.is_empty() {
            let end = rest.find(['.', '[']).unwrap_or(rest.len());
            let (name, behind) = rest.split_at(end);
            if !name.is_empty() {
                steps.push(Step::Field(name.to_owned()));
            }
            rest = behind;
            while let Some(inside) = rest.strip_prefix('[') {
                let (key, behind) = inside.split_once(']').ok_or_else(wrong)?;
                steps.push(match (key.parse(), key.split_once('=')) {
                    (Ok(n), _) => Step::Element(n),
                    (_, Some((field, text))) => Step::Named(field.to_owned(), text.to_owned()),
                    _ => Step::Named("name".to_owned(), key.to_owned()),
                });
                rest = behind;
            }
            rest = match rest.strip_prefix('.') {
                Some(behind) if !behind.is_empty() && !behind.starts_with(['.', '[']) => behind,
                None if rest.is_empty() => rest,
                _ => return Err(wrong()),
            };
        }
        match steps.first() {
            None | Some(Step::Field(_)) => Ok(Self {
                text: text.to_owned(),
                steps,
            }),
            _ => Err(wrong()),
        }
    }

    /// Finds the value in a message; `None` where an element is not there.
    ///
    /// # Errors
    /// A sentence for fields that such a message never has.
    pub(super) fn find<'v, 'a>(
        &self,
        message: &'v Value<'a>,
    ) -> Result<Option<Found<'v, 'a>>, String> {
        let mut found = Found {
            value: FoundValue::Value(message),
            within: message,
            stamp_ns: message.stamp_ns(),
        };
        for step in &self.steps {
            let FoundValue::Value(value) = found.value else {
                return Err(format!("{}: a number has no fields", self.text));
            };
            let next = match (step, value) {
                (Step::Field(name), Value::Message(of, _)) => {
                    found.within = value;
                    let field = value.field(name).ok_or_else(|| {
                        format!(
                            "there is no field '{}': {} has {}",
                            self.text,
                            of.name,
                            of.field_names()
                        )
                    })?;
                    Some(FoundValue::Value(field))
                }
                (Step::Element(i), Value::Numbers(numbers)) => {
                    numbers.get(*i).map(FoundValue::Number)
                }
                (Step::Element(i), Value::List(list)) => list.get(*i).map(FoundValue::Value),
                (Step::Named(key, text), Value::Numbers(numbers)) => {
                    let Some(Value::List(names)) = found.within.field(key) else {
                        return Err(format!(
                            "{}: there is no sequence '{key}' beside it",
                            self.text
                        ));
                    };
                    let is = |n: &Value| matches!(n, Value::Text(t) if *t == text.as_bytes());
                    let at = names.iter().position(is);
                    at.and_then(|i| numbers.get(i)).map(FoundValue::Number)
                }
                (Step::Named(key, text), Value::List(list)) => {
                    let is = |element: &&Value<'a>| matches!(element.field(key), Some(Value::Text(t)) if *t == text.as_bytes());
                    list.iter().find(is).map(FoundValue::Value)
                }
                (_, other) => {
                    return Err(format!(
                        "there is no field '{}': before its end stands {}",
                        self.text,
                        other.what()
                    ));
                }
            };
            let Some(next) = next else {
                return Ok(None);
            };
            found.value = next;
            if let FoundValue::Value(value) = next {
                found.stamp_ns = value.stamp_ns().or(found.stamp_ns);
            }
        }
        Ok(Some(found))
    }
}

impl FoundValue<'_, '_> {
    /// The number.
    ///
    /// # Errors
    /// A sentence with what it is instead.
    pub(super) fn number(self) -> Result<f64, String> {
        match self {
            Self::Number(x) => Ok(x),
            Self::Value(Value::Number(x)) => Ok(*x),
            Self::Value(other) => Err(format!("a number is needed, and it is {}", other.what())),
        }
    }

    /// The quaternion x, y, z, w.
    ///
    /// # Errors
    /// As [`Self::number`].
    pub(super) fn turn(self) -> Result<[f64; 4], String> {
        let of = |v: &Value| {
            let all = ["x", "y", "z", "w"].map(|name| v.number(name));
            Some([all[0]?, all[1]?, all[2]?, all[3]?])
        };
        let found = match self {
            Self::Value(value) => of(value),
            Self::Number(_) => None,
        };
        found.ok_or_else(|| format!("a quaternion is needed, and it is {}", self.what()))
    }

    /// A position and a quaternion: of a pose, or of a transform.
    ///
    /// # Errors
    /// As [`Self::number`].
    pub(super) fn place(self) -> Result<[f64; 7], String> {
        let of = |v: &Value| {
            let at = v.field("position").or(v.field("translation"))?;
            let turn = v.field("orientation").or(v.field("rotation"))?;
            let turn = FoundValue::Value(turn).turn().ok()?;
            let at = ["x", "y", "z"].map(|name| at.number(name));
            Some([at[0]?, at[1]?, at[2]?, turn[0], turn[1], turn[2], turn[3]])
        };
        let found = match self {
            Self::Value(value) => of(value),
            Self::Number(_) => None,
        };
        found.ok_or_else(|| format!("a pose or transform is needed, and it is {}", self.what()))
    }

    fn what(self) -> String {
        match self {
            Self::Number(_) => "a number".to_owned(),
            Self::Value(value) => value.what(),
        }
    }
}
