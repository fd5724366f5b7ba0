//! A pinhole camera in world space and its translations into what selection and shaders need.
//!
//! Everything after this file is relative to the eye, so that nothing large is ever subtracted in f32.

use glam::{DVec3, Mat4, Vec3, Vec4};
use pb_lod::{plan, progressive_buffers::display::GridEye, progressive_buffers::layout::ModelRecord};

/// Largest distance of the eye cell from the grid's origin, quanta: keeps differences inside i32.
const CELL_LIMIT: f64 = (1u32 << 30) as f64;

/// Where the picture is taken from. World space is the input's space, in input units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Eye position.
    pub eye: DVec3,
    /// A point in the middle of the picture, not at the eye.
    pub target: DVec3,
    /// Which way is up; not parallel to the line of sight.
    pub up: DVec3,
    /// Vertical field of view, degrees, more than 0 and less than 180.
    pub fov_deg: f64,
    /// Distance of the near plane, world units. There is no far plane.
    pub near: f64,
}

/// The camera's axes: right, up, back; unit vectors, world space.
struct Axes {
    right: Vec3,
    up: Vec3,
    back: Vec3,
}

impl Camera {
    fn axes(&self) -> Axes {
        let back = (self.eye - self.target).normalize_or(DVec3::Z);
        let right = self.up.cross(back).try_normalize().unwrap_or_else(|| back.any_orthonormal_vector());
        let up = back.cross(right);
        Axes { right: right.as_vec3(), up: up.as_vec3(), back: back.as_vec3() }
    }

    /// Unit vector of the line of sight, world space.
    pub fn forward(&self) -> DVec3 {
        -self.axes().back.as_dvec3()
    }

    /// Unit vector to the right of the picture, world space.
    pub fn right(&self) -> DVec3 {
        self.axes().right.as_dvec3()
    }

    /// Unit vector to the top of the picture, world space.
    pub fn screen_up(&self) -> DVec3 {
        self.axes().up.as_dvec3()
    }

    /// `tan` of half the field of view, horizontal and vertical, for a picture of `size` pixels.
    fn half_extent(&self, size: [u32; 2]) -> [f32; 2] {
        let y = (self.fov_deg.to_radians() * 0.5).tan();
        [(y * size[0] as f64 / size[1] as f64) as f32, y as f32]
    }

    /// World directions (eye at the origin) to clip space; depth is near / distance, 0 at infinity.
    pub fn clip_from_eye(&self, size: [u32; 2]) -> Mat4 {
        let a = self.axes();
        let [x, y] = self.half_extent(size);
        let rows = [a.right.extend(0.0) / x, a.up.extend(0.0) / y, Vec4::W * self.near as f32, -a.back.extend(0.0)];
        Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose()
    }

    /// Angle of one pixel at the picture's centre, radians.
    pub fn pixel_angle(&self, size: [u32; 2]) -> f32 {
        2.0 * self.half_extent(size)[1] / size[1] as f32
    }

    /// What selection sees: eye, the four sides and the front of the frustum, the pixel angle.
    pub fn view(&self, size: [u32; 2]) -> plan::View {
        let a = self.axes();
        let [x, y] = self.half_extent(size);
        let forward = -a.back;
        let side = |across: Vec3, extent: f32| (forward * extent - across).normalize().extend(0.0);
        plan::View {
            eye: self.eye,
            planes: vec![side(a.right, x), side(-a.right, x), side(a.up, y), side(-a.up, y), forward.extend(0.0)],
            pixel_angle: self.pixel_angle(size),
        }
    }
}

/// `eye` (world space) on the model's grid: `eye = origin + cell * quantum + rest`.
pub fn grid_eye(model: &ModelRecord, eye: DVec3) -> GridEye {
    let at = eye.to_array();
    let cell: [f64; 3] = std::array::from_fn(|k| {
        let cells = ((at[k] - model.origin[k]) / model.quantum).floor();
        cells.clamp(-CELL_LIMIT, CELL_LIMIT)
    });
    GridEye {
        cell: cell.map(|c| c as i32),
        rest: std::array::from_fn(|k| (at[k] - model.origin[k] - cell[k] * model.quantum) as f32),
        quantum: model.quantum as f32,
    }
}
