//! Pictures as files: tone-mapped as .png, radiance as .exr. Each is replaced whole.

use std::path::Path;

use luxel_export::{Effort, Image8, ToneMap, encode_png_with, openexr::Exr, write_atomic, write_atomic_with};
use luxel_scene::{Progress, Watched};

use super::Picture;
use crate::Error;

/// Writes a picture under both names.
///
/// # Errors
/// What cannot be written, with its name; when it is no longer wanted.
pub fn write(
    picture: &Picture,
    tone: &ToneMap,
    (png, exr): (&Path, &Path),
    progress: &dyn Progress,
) -> Result<(), Error> {
    let Picture { width, height, radiance, .. } = picture;
    let encoded = Exr::picture(*width, *height, radiance)?;
    write_atomic_with(exr, |file| encoded.write(&mut std::io::BufWriter::new(Watched::new(file, progress))))
        .map_err(Error::from)?;
    write_image(&tone.picture(*width, *height, radiance, progress)?, png, progress)
}

/// Writes an image as .png.
///
/// # Errors
/// As [`write`].
pub fn write_image(image: &Image8, png: &Path, progress: &dyn Progress) -> Result<(), Error> {
    Ok(write_atomic(png, &encode_png_with(image, Effort::Small, progress)?)?)
}
