//! Local transforms of nodes and of GPU instances, in double precision (glTF 2.0 §3.5.2).

use glam::{DAffine3, DMat3, DQuat, DVec3, DVec4};
use serde_json::Value;

use super::error::{Checked, Fault};

/// Largest coordinate that the importer lets into the world: its square still fits into single precision.
pub const MAX_COORDINATE: f64 = 1e18;

/// A node's transform to its parent, as the file states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local {
    affine: DAffine3,
}

impl Local {
    pub fn affine(&self) -> DAffine3 {
        self.affine
    }

    /// Reads `matrix`, or `translation`, `rotation` and `scale`, of a node. A matrix wins where both are given.
    pub fn read(node: &Value, place: &str) -> Checked<Self> {
        let affine = match numbers::<16>(node, "matrix", place)? {
            Some(m) => from_matrix(&m, place)?,
            None => {
                let translation = numbers(node, "translation", place)?.map_or(DVec3::ZERO, DVec3::from_array);
                let rotation = numbers(node, "rotation", place)?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
                let scale = numbers(node, "scale", place)?.map_or(DVec3::ONE, DVec3::from_array);
                from_trs(translation, DVec4::from_array(rotation), scale)
                    .ok_or_else(|| Fault::invalid(place, "its rotation is the zero quaternion"))?
            }
        };
        Ok(Self { affine })
    }
}

/// T · R · S; the quaternion is normalised, None if it has no direction.
pub fn from_trs(translation: DVec3, rotation: DVec4, scale: DVec3) -> Option<DAffine3> {
    let length = rotation.length();
    if length.is_nan() || length < 1e-12 {
        return None;
    }
    let rotation = DQuat::from_vec4(rotation / length);
    Some(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}

fn from_matrix(m: &[f64; 16], place: &str) -> Checked<DAffine3> {
    let column = |i: usize| DVec3::new(m[i], m[i + 1], m[i + 2]);
    let bottom = DVec4::new(m[3], m[7], m[11], m[15]);
    if !bottom.abs_diff_eq(DVec4::W, 1e-4) {
        return Err(Fault::invalid(place, "the last row of its matrix is not 0 0 0 1"));
    }
    let matrix3 = DMat3::from_cols(column(0), column(4), column(8));
    Ok(DAffine3 { matrix3, translation: column(12) })
}

/// An array of exactly N finite numbers.
fn numbers<const N: usize>(node: &Value, key: &str, place: &str) -> Checked<Option<[f64; N]>> {
    let Some(value) = node.get(key) else { return Ok(None) };
    let wrong = || Fault::invalid(place, format!("its {key} is not an array of {N} numbers"));
    let values = value.as_array().filter(|a| a.len() == N).ok_or_else(wrong)?;
    let mut out = [0.0; N];
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = value.as_f64().filter(|f| f.is_finite()).ok_or_else(wrong)?;
    }
    Ok(Some(out))
}

/// Does the linear part flatten space (to working precision of what was stored in single precision)?
///
/// The determinant is compared with the product of the columns' lengths, so that a uniform scale, however small, is
/// not mistaken for a flattening one.
pub fn is_singular(matrix: &DMat3) -> bool {
    let volume = matrix.x_axis.length() * matrix.y_axis.length() * matrix.z_axis.length();
    // A volume of zero, and one that is not a number, is flat as well.
    let share = matrix.determinant().abs() / volume;
    share.is_nan() || share <= 1e-10
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn matrix_and_trs_agree() {
        let half = (0.5f64).sqrt();
        // A quarter turn about +Y takes +X to −Z.
        let trs = json!({"translation": [1, 2, 3], "rotation": [0, half, 0, half], "scale": [2, 3, 4]});
        let matrix = json!({"matrix": [0, 0, -2, 0, 0, 3, 0, 0, 4, 0, 0, 0, 1, 2, 3, 1]});
        let trs = Local::read(&trs, "").unwrap().affine();
        let matrix = Local::read(&matrix, "").unwrap().affine();
        assert!(trs.abs_diff_eq(matrix, 1e-15), "{trs:?} {matrix:?}");
    }

    #[test]
    fn quaternions_are_normalised_and_zero_is_refused() {
        let double = Local::read(&json!({"rotation": [0, 2, 0, 0]}), "").unwrap().affine();
        assert!(
            double.matrix3.determinant() - 1.0 < 1e-15
                && (double.transform_vector3(DVec3::X) + DVec3::X).length() < 1e-15
        );
        assert!(Local::read(&json!({"rotation": [0, 0, 0, 0]}), "node 0").is_err());
    }

    #[test]
    fn malformed_arrays_are_refused() {
        for node in [
            json!({"matrix": [1, 2]}),
            json!({"translation": "up"}),
            json!({"scale": [1, 1, null]}),
            json!({"matrix": [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}),
        ] {
            assert!(Local::read(&node, "node 0").is_err(), "{node}");
        }
    }

    #[test]
    fn singular_is_relative() {
        assert!(!is_singular(&DMat3::from_diagonal(DVec3::splat(1e-9))));
        assert!(!is_singular(&DMat3::from_diagonal(DVec3::new(1.0, 1.0, 1e-9))));
        assert!(is_singular(&DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0))));
        assert!(is_singular(&DMat3::from_cols(DVec3::X, DVec3::X, DVec3::Z)));
    }
}
