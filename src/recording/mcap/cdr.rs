//! CDR, the encoding of ROS 2 messages: OMG DDS-XTypes 1.3, 7.4.1 and 7.6.3.1.2, version 1 (XCDR1).
//!
//! Four bytes come first: `00 01` for little-endian (`00 00` for big-endian) and two that are ignored. A number of n bytes then
//! stands at a multiple of n, counted from behind them. A text is its length with the final zero (u32), its bytes, and the zero. A
//! sequence is its number of elements (u32) and the elements; an array of a fixed length is its elements.

/// Bytes of the header.
const HEADER: usize = 4;

/// A number of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Number {
    /// The number that a message definition names so; `None` for other types.
    pub(super) fn named(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            "byte" | "char" | "uint8" => Self::U8,
            "int8" => Self::I8,
            "uint16" => Self::U16,
            "int16" => Self::I16,
            "uint32" => Self::U32,
            "int32" => Self::I32,
            "uint64" => Self::U64,
            "int64" => Self::I64,
            "float32" => Self::F32,
            "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Its size, bytes.
    pub(super) fn size(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Its value of as many bytes as it has; integers of 64 bits lose what a double does not hold.
    fn value(self, bytes: &[u8], order: Order) -> f64 {
        fn of<const N: usize>(bytes: &[u8], order: Order) -> [u8; N] {
            let mut out = [0; N];
            out.copy_from_slice(&bytes[..N]);
            if order == Order::Big {
                out.reverse();
            }
            out
        }
        match self {
            Self::Bool | Self::U8 => f64::from(bytes[0]),
            Self::I8 => f64::from(bytes[0] as i8),
            Self::U16 => f64::from(u16::from_le_bytes(of(bytes, order))),
            Self::I16 => f64::from(i16::from_le_bytes(of(bytes, order))),
            Self::U32 => f64::from(u32::from_le_bytes(of(bytes, order))),
            Self::I32 => f64::from(i32::from_le_bytes(of(bytes, order))),
            Self::U64 => u64::from_le_bytes(of(bytes, order)) as f64,
            Self::I64 => i64::from_le_bytes(of(bytes, order)) as f64,
            Self::F32 => f64::from(f32::from_le_bytes(of(bytes, order))),
            Self::F64 => f64::from_le_bytes(of(bytes, order)),
        }
    }
}

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    Little,
    Big,
}

/// Numbers of one kind in a row, as they stand in a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbers<'a> {
    kind: Number,
    order: Order,
    bytes: &'a [u8],
}

impl Numbers<'_> {
    /// How many they are.
    pub(super) fn len(&self) -> usize {
        self.bytes.len() / self.kind.size()
    }

    /// One of them; `None` behind the last one.
    pub(super) fn get(&self, i: usize) -> Option<f64> {
        let size = self.kind.size();
        let from = i.checked_mul(size)?;
        let bytes = self.bytes.get(from..from.checked_add(size)?)?;
        Some(self.kind.value(bytes, self.order))
    }
}

/// Writes a message, little-endian.
pub(super) struct CdrWriter(Vec<u8>);

impl CdrWriter {
    /// A message without a field.
    pub(super) fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        let filled = (self.0.len() - HEADER).next_multiple_of(N);
        self.0.resize(HEADER + filled, 0);
        self.0.extend_from_slice(&bytes);
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.put([value]);
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.put(value.to_le_bytes());
    }

    pub(super) fn i32(&mut self, value: i32) {
        self.put(value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.put(value.to_le_bytes());
    }

    /// Numbers in a row, as an array of a fixed length.
    pub(super) fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|v| self.f64(*v));
    }

    /// The number of elements of a sequence.
    pub(super) fn length(&mut self, n: usize) {
        // Sequences of this program are of a few elements.
        self.u32(u32::try_from(n).unwrap_or(u32::MAX));
    }

    /// A text. One that is longer than the format has numbers for is cut.
    pub(super) fn text(&mut self, text: &str) {
        let bytes = text.as_bytes();
        let bytes = &bytes[..bytes.len().min(u32::MAX as usize - 1)];
        self.length(bytes.len() + 1);
        self.0.extend_from_slice(bytes);
        self.0.push(0);
    }

    /// The message.
    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Reads a message. Nothing is allocated: what is read are views of the message.
pub(super) struct CdrReader<'a> {
    /// What comes behind the header.
    bytes: &'a [u8],
    at: usize,
    order: Order,
}

impl<'a> CdrReader<'a> {
    /// Begins with a message.
    ///
    /// # Errors
    /// A sentence: the header is not there, or is of an encoding other than plain CDR.
    pub(super) fn new(message: &'a [u8]) -> Result<Self, String> {
        let Some((header, bytes)) = message.split_at_checked(HEADER) else {
            return Err("it is shorter than its header".to_owned());
        };
        let order = match (header[0], header[1]) {
            (0, 0) => Order::Big,
            (0, 1) => Order::Little,
            (a, b) => {
                return Err(format!(
                    "its encoding is {a:02x}{b:02x}, and plain CDR (0001 or 0000) is read"
                ));
            }
        };
        Ok(Self {
            bytes,
            at: 0,
            order,
        })
    }

    /// Bytes that are left.
    pub(super) fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let left = &self.bytes[self.at..];
        let Some(taken) = left.get(..n) else {
            return Err(format!("it ends {} bytes early", n - left.len()));
        };
        self.at += n;
        Ok(taken)
    }

    /// `n` numbers in a row. Without any, nothing is aligned either.
    pub(super) fn numbers(&mut self, kind: Number, n: usize) -> Result<Numbers<'a>, String> {
        let size = kind.size();
        if n > 0 {
            let fill = self.at.next_multiple_of(size) - self.at;
            self.take(fill)?;
        }
        let bytes = n.checked_mul(size).ok_or("it ends early")?;
        Ok(Numbers {
            kind,
            order: self.order,
            bytes: self.take(bytes)?,
        })
    }

    /// One number.
    pub(super) fn number(&mut self, kind: Number) -> Result<f64, String> {
        let one = self.numbers(kind, 1)?;
        one.get(0).ok_or_else(|| "it ends early".to_owned())
    }

    /// The number of elements of a sequence, each of which has one byte at least.
    pub(super) fn length(&mut self) -> Result<usize, String> {
        let n = self.number(Number::U32)? as usize;
        match n <= self.left() {
            true => Ok(n),
            false => Err(format!(
                "a sequence of {n} elements is in the last {} bytes of it",
                self.left()
            )),
        }
    }

    /// A text without its final zero.
    pub(super) fn text(&mut self) -> Result<&'a [u8], String> {
        let n = self.length()?;
        let bytes = self.take(n)?;
        Ok(bytes.strip_suffix(&[0]).unwrap_or(bytes))
    }
}
