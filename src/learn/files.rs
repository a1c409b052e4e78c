//! Trained networks as safetensors: tensors for the numbers, one metadata entry for the rest.
//!
//! | tensor | type, shape |
//! |---|---|
//! | `smap.M.weight.L`, `smap.M.bias.L` | f32, out × in and out; member M, layer L |
//! | `smap.M.input`, `smap.M.output` | f64, 2 × width: mean, standard deviation |
//! | `translation.…`, `rotation.…`, `plant.…` | the same for the other networks |
//! | `spread.mean`, `spread.whitening` | f64, 24 and 24 × 24 (row-major) |
//! | `calibration.noise`, `calibration.shares` | f64, 24, and 4 × 2: noise, spread, rest and its growth, for translation and rotation |
//! | `calibration.moment`, `calibration.distance_p95` | f64, 6 × 6 and 1 |
//! | `plant.bounds` | f64, 7 × 2: lowest and highest of each pressure and of the payload |
//! | `guess` | f32, samples × 37: pressures, payload, signals, pose |
//!
//! The metadata entry `springtwin` is JSON: format number, recipe (as the TOML text that
//! reproduces the model) and scores. This module only turns models into bytes and back; the caller
//! reads and writes files.

use std::borrow::Cow;
use std::collections::HashMap;

use nalgebra::{SMatrix, SVector};
use safetensors::tensor::{Dtype, SafeTensors, View};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::calibrate::Calibration;
use super::cascade::{Cascade, CascadeParts, Correction, SensorSpread, ShapeError};
use super::guess::{GuessSet, ROW};
use super::mlp::{Mlp, Scaling};
use super::plant::{PlantBounds, PlantNet};
use super::recipe::{HIDDEN_LAYERS_MAX, MEMBERS_MAX, Recipe, WIDTH_MAX};
use super::scores::{CorrectionReport, PlantReport, PoseReport};
use crate::signal::{CHAMBERS, Matrix6, SIGNALS, hex};

/// Number of the layout written here.
const FORMAT: u32 = 2;
/// Name of the metadata entry.
const ENTRY: &str = "springtwin";
/// Longest header that is looked at, bytes.
const HEADER_MAX: usize = 1 << 22;

/// Scores of everything in a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// The sensor map.
    pub smap: PoseReport,
    /// The sim-to-real correction; `None` if it was not trained.
    pub s2r: Option<CorrectionReport>,
    /// The plant.
    pub plant: PlantReport,
}

/// Everything that is learned about one robot.
#[derive(Clone, Debug)]
pub struct Model {
    /// Sensors to pose.
    pub cascade: Cascade,
    /// Pressures to sensors.
    pub plant: PlantNet,
    /// Samples for the initial guess.
    pub guess: GuessSet,
    /// How well it came out.
    pub scores: Scores,
    /// How it was trained.
    pub recipe: Recipe,
    /// SHA-256 of the file that it was read from, hexadecimal; empty for one that was just trained.
    pub hash: String,
}

/// Why a network file was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// Not a safetensors file, truncated or damaged.
    #[error("the network file is not a whole safetensors file ({0}); copy or train it again")]
    Container(String),
    /// Made by something else or by another version.
    #[error("the network file has no valid springtwin description ({0}); train the networks again")]
    Description(String),
    /// A tensor is absent.
    #[error("the network file has no tensor {0}; train the networks again")]
    Missing(String),
    /// A tensor has the wrong type or shape.
    #[error("tensor {name} of the network file is {got}, but {want} is needed; train again")]
    Tensor {
        /// The tensor.
        name: String,
        /// Its type and shape.
        got: String,
        /// What it must be.
        want: String,
    },
    /// A number is infinite or not a number, or a deviation negative.
    #[error("tensor {0} of the network file holds a value that makes no sense; train again")]
    Value(String),
    /// Networks do not fit their places.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

#[derive(Serialize, Deserialize)]
struct Description {
    format: u32,
    members: usize,
    correction: Corrected,
    recipe: String,
    scores: Scores,
}

#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Corrected {
    /// Translation and rotation.
    Yes,
    No,
    Translation,
    Rotation,
}

impl Model {
    /// The model as a file's bytes. The same model gives the same bytes.
    ///
    /// # Errors
    /// [`ModelError::Container`] when the header would be too large.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ModelError> {
        let parts = self.cascade.parts();
        let mut tensors = Vec::new();
        for (m, net) in parts.smap.iter().enumerate() {
            put_net(&mut tensors, &format!("smap.{m}"), net);
        }
        let c = &parts.correction;
        for (name, net) in [("translation", &c.translation), ("rotation", &c.rotation)] {
            if let Some(net) = net {
                put_net(&mut tensors, name, net);
            }
        }
        put_net(&mut tensors, "plant", self.plant.net());
        let spread = &parts.spread;
        put(
            &mut tensors,
            "spread.mean",
            &[SIGNALS],
            spread.mean.as_slice(),
        );
        let shape = [SIGNALS, SIGNALS];
        let whitening = spread.whitening.transpose();
        put(
            &mut tensors,
            "spread.whitening",
            &shape,
            whitening.as_slice(),
        );
        let calibration = &parts.calibration;
        let noise = calibration.noise.as_slice();
        put(&mut tensors, "calibration.noise", &[SIGNALS], noise);
        let mut shares = calibration.shares.to_vec();
        shares.push(calibration.growth);
        put(
            &mut tensors,
            "calibration.shares",
            &[4, 2],
            shares.as_flattened(),
        );
        let moment = calibration.moment.transpose();
        put(
            &mut tensors,
            "calibration.moment",
            &[6, 6],
            moment.as_slice(),
        );
        let distance = [parts.calibration.distance_p95];
        put(&mut tensors, "calibration.distance_p95", &[1], &distance);
        let bounds = self.plant.bounds();
        let mut rows = bounds.chamber_pa.to_vec();
        rows.push(bounds.payload_kg);
        put(
            &mut tensors,
            "plant.bounds",
            &[rows.len(), 2],
            rows.as_flattened(),
        );
        let guess = self.guess.to_rows();
        put(&mut tensors, "guess", &[guess.len() / ROW, ROW], &guess);

        let description = Description {
            format: FORMAT,
            members: parts.smap.len(),
            correction: match (&c.translation, &c.rotation) {
                (Some(_), Some(_)) => Corrected::Yes,
                (Some(_), None) => Corrected::Translation,
                (None, Some(_)) => Corrected::Rotation,
                (None, None) => Corrected::No,
            },
            recipe: self.recipe.to_toml(),
            scores: self.scores.clone(),
        };
        let text = serde_json::to_string(&description)
            .map_err(|e| ModelError::Description(e.to_string()))?;
        // A single entry: the order of several would differ from run to run.
        let metadata = HashMap::from([(ENTRY.to_owned(), text)]);
        safetensors::serialize(tensors, Some(metadata))
            .map_err(|e| ModelError::Container(e.to_string()))
    }

    /// Reads a model from a file's bytes.
    ///
    /// # Errors
    /// [`ModelError`], naming the tensor where one is at fault. Hostile bytes do not panic, and
    /// memory stays within a small multiple of the file's size.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        check_header(bytes)?;
        let container = |e: safetensors::SafeTensorError| ModelError::Container(e.to_string());
        let tensors = SafeTensors::deserialize(bytes).map_err(container)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(container)?;
        let text = header
            .metadata()
            .as_ref()
            .and_then(|m| m.get(ENTRY))
            .ok_or_else(|| ModelError::Description("the entry is absent".to_owned()))?;
        let description: Description =
            serde_json::from_str(text).map_err(|e| ModelError::Description(e.to_string()))?;
        let recipe = check_description(&description)?;

        let smap = (0..description.members)
            .map(|m| net(&tensors, &format!("smap.{m}")))
            .collect::<Result<Vec<_>, _>>()?;
        let used = |name: &str, by: [Corrected; 2]| {
            let used = by.contains(&description.correction);
            used.then(|| net(&tensors, name)).transpose()
        };
        let correction = Correction {
            translation: used("translation", [Corrected::Yes, Corrected::Translation])?,
            rotation: used("rotation", [Corrected::Yes, Corrected::Rotation])?,
        };
        let spread = SensorSpread {
            mean: nalgebra::SVector::from_column_slice(&get::<f64>(
                &tensors,
                "spread.mean",
                &[SIGNALS],
            )?),
            whitening: SMatrix::from_row_slice(&get::<f64>(
                &tensors,
                "spread.whitening",
                &[SIGNALS, SIGNALS],
            )?),
        };
        let noise = get::<f64>(&tensors, "calibration.noise", &[SIGNALS])?;
        let shares = get::<f64>(&tensors, "calibration.shares", &[4, 2])?;
        for (name, values) in [
            ("calibration.noise", &noise),
            ("calibration.shares", &shares),
        ] {
            if values.iter().any(|x| *x < 0.0) {
                return Err(ModelError::Value(name.to_owned()));
            }
        }
        let moment = get::<f64>(&tensors, "calibration.moment", &[6, 6])?;
        let distance_p95 = get::<f64>(&tensors, "calibration.distance_p95", &[1])?[0];
        if distance_p95 <= 0.0 {
            return Err(ModelError::Value("calibration.distance_p95".to_owned()));
        }
        let cascade = Cascade::new(CascadeParts {
            smap,
            correction,
            spread,
            calibration: Calibration {
                noise: SVector::from_column_slice(&noise),
                shares: std::array::from_fn(|k| [shares[2 * k], shares[2 * k + 1]]),
                growth: [shares[6], shares[7]],
                moment: Matrix6::from_row_slice(&moment),
                distance_p95,
                systematic: match description.scores.s2r {
                    Some(_) => recipe.reference,
                    None => recipe.unit,
                },
            },
        })?;
        let rows = shape_of(&tensors, "guess")?.first().copied().unwrap_or(0);
        Ok(Self {
            cascade,
            plant: PlantNet::new(net(&tensors, "plant")?, plant_bounds(&tensors)?)?,
            guess: GuessSet::from_rows(&get::<f32>(&tensors, "guess", &[rows, ROW])?),
            scores: description.scores,
            recipe,
            hash: hex(&Sha256::digest(bytes)),
        })
    }
}

/// Refuses headers whose tensors reach beyond the file, before the container's own arithmetic.
fn check_header(bytes: &[u8]) -> Result<(), ModelError> {
    let bad = |what: &str| ModelError::Container(what.to_owned());
    let (length, rest) = bytes
        .split_first_chunk::<8>()
        .ok_or_else(|| bad("shorter than its header"))?;
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    if length > HEADER_MAX {
        return Err(bad("the header is too long"));
    }
    let header = rest
        .get(..length)
        .ok_or_else(|| bad("the header is cut off"))?;
    let header: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(header)
        .map_err(|e| ModelError::Container(format!("header: {e}")))?;
    let data = (rest.len() - length) as u64;
    for (name, info) in header.iter().filter(|(name, _)| *name != "__metadata__") {
        let offsets = info.get("data_offsets").and_then(|o| o.as_array());
        let inside = offsets.is_some_and(|o| {
            o.len() == 2 && o.iter().all(|x| x.as_u64().is_some_and(|x| x <= data))
        });
        if !inside {
            return Err(bad(&format!("tensor {name:.40} lies outside of the file")));
        }
    }
    Ok(())
}

fn check_description(d: &Description) -> Result<Recipe, ModelError> {
    let bad = |what: String| Err(ModelError::Description(what));
    if d.format != FORMAT {
        return bad(format!("format {}, this program reads {FORMAT}", d.format));
    }
    if !(1..=MEMBERS_MAX).contains(&d.members) {
        return bad(format!("{} sensor maps", d.members));
    }
    Recipe::from_toml(&d.recipe).map_err(|e| ModelError::Description(e.to_string()))
}

fn plant_bounds(tensors: &SafeTensors) -> Result<PlantBounds, ModelError> {
    let name = "plant.bounds";
    let flat = get::<f64>(tensors, name, &[CHAMBERS + 1, 2])?;
    let (rows, _) = flat.as_chunks::<2>();
    if rows.iter().any(|[lo, hi]| lo > hi) {
        return Err(ModelError::Value(name.to_owned()));
    }
    Ok(PlantBounds {
        chamber_pa: std::array::from_fn(|i| rows[i]),
        payload_kg: rows[CHAMBERS],
    })
}

/// A tensor on its way into a file.
struct Tensor {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl View for Tensor {
    fn dtype(&self) -> Dtype {
        self.dtype
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }

    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

/// The two number types in a file.
trait Number: Copy {
    const DTYPE: Dtype;
    const WIDTH: usize;
    fn write(self, out: &mut Vec<u8>);
    /// From exactly `WIDTH` bytes.
    fn read(bytes: &[u8]) -> Self;
    fn is_finite(self) -> bool;
}

macro_rules! number {
    ($type:ty, $dtype:expr) => {
        impl Number for $type {
            const DTYPE: Dtype = $dtype;
            const WIDTH: usize = size_of::<$type>();

            fn write(self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }

            fn read(bytes: &[u8]) -> Self {
                Self::from_le_bytes(std::array::from_fn(|i| bytes[i]))
            }

            fn is_finite(self) -> bool {
                <$type>::is_finite(self)
            }
        }
    };
}
number!(f32, Dtype::F32);
number!(f64, Dtype::F64);

fn put<T: Number>(tensors: &mut Vec<(String, Tensor)>, name: &str, shape: &[usize], data: &[T]) {
    let mut bytes = Vec::with_capacity(data.len() * T::WIDTH);
    data.iter().for_each(|x| x.write(&mut bytes));
    let tensor = Tensor {
        dtype: T::DTYPE,
        shape: shape.to_vec(),
        bytes,
    };
    tensors.push((name.to_owned(), tensor));
}

fn put_net(tensors: &mut Vec<(String, Tensor)>, name: &str, net: &Mlp) {
    for l in 0..net.layers() {
        let (weights, biases) = net.layer(l);
        let (n_in, n_out) = (net.sizes[l], net.sizes[l + 1]);
        put(
            tensors,
            &format!("{name}.weight.{l}"),
            &[n_out, n_in],
            weights,
        );
        put(tensors, &format!("{name}.bias.{l}"), &[n_out], biases);
    }
    for (which, scaling) in [("input", &net.input), ("output", &net.output)] {
        let both = [scaling.mean.as_slice(), &scaling.std].concat();
        let shape = [2, scaling.mean.len()];
        put(tensors, &format!("{name}.{which}"), &shape, &both);
    }
}

fn shape_of(tensors: &SafeTensors, name: &str) -> Result<Vec<usize>, ModelError> {
    match tensors.tensor(name) {
        Ok(t) => Ok(t.shape().to_vec()),
        Err(_) => Err(ModelError::Missing(name.to_owned())),
    }
}

/// A tensor's finite numbers, when type and shape are as wanted.
fn get<T: Number>(
    tensors: &SafeTensors,
    name: &str,
    shape: &[usize],
) -> Result<Vec<T>, ModelError> {
    let t = tensors
        .tensor(name)
        .map_err(|_| ModelError::Missing(name.to_owned()))?;
    if t.dtype() != T::DTYPE || t.shape() != shape {
        return Err(ModelError::Tensor {
            name: name.to_owned(),
            got: format!("{:?} {:?}", t.dtype(), t.shape()),
            want: format!("{:?} {shape:?}", T::DTYPE),
        });
    }
    let numbers: Vec<T> = t.data().chunks_exact(T::WIDTH).map(T::read).collect();
    if numbers.iter().all(|x| x.is_finite()) {
        Ok(numbers)
    } else {
        Err(ModelError::Value(name.to_owned()))
    }
}

fn net(tensors: &SafeTensors, name: &str) -> Result<Mlp, ModelError> {
    let mut sizes: Vec<usize> = Vec::new();
    let mut params = Vec::new();
    for l in 0..=HIDDEN_LAYERS_MAX {
        let weight = format!("{name}.weight.{l}");
        if l > 0 && tensors.tensor(&weight).is_err() {
            break;
        }
        let shape = shape_of(tensors, &weight)?;
        let fits = shape.len() == 2
            && shape.iter().all(|w| (1..=WIDTH_MAX).contains(w))
            && sizes.last().is_none_or(|w| *w == shape[1]);
        if !fits {
            return Err(ModelError::Tensor {
                name: weight,
                got: format!("{shape:?}"),
                want: format!("out × in, at most {WIDTH_MAX}, in = out of the layer before"),
            });
        }
        if l == 0 {
            sizes.push(shape[1]);
        }
        sizes.push(shape[0]);
        params.extend(get::<f32>(tensors, &weight, &shape)?);
        let bias = format!("{name}.bias.{l}");
        params.extend(get::<f32>(tensors, &bias, &shape[..1])?);
    }
    let scaling = |which: &str, width: usize| {
        let name = format!("{name}.{which}");
        let both = get::<f64>(tensors, &name, &[2, width])?;
        let (mean, std) = both.split_at(width);
        if std.iter().any(|s| *s < 0.0) {
            return Err(ModelError::Value(name));
        }
        Ok(Scaling {
            mean: mean.to_vec(),
            std: std.to_vec(),
        })
    };
    Ok(Mlp {
        input: scaling("input", sizes[0])?,
        output: scaling("output", sizes[sizes.len() - 1])?,
        sizes,
        params,
    })
}

#[cfg(test)]
#[path = "files_tests.rs"]
mod tests;
