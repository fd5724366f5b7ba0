//! pb-bake as a whole: what it prints, what it leaves behind, how it exits.

mod archives;
mod bake;
#[cfg(unix)]
mod doctor;
mod harness;
mod resume;
mod shared_files;
mod textured_export;
mod textures;
#[cfg(unix)]
mod xatlas;
