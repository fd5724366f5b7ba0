//! What can go wrong between the program and the graphics adapter.

/// Errors of the renderer. All but [`RenderError::BoundTooSmall`] are the machine's fault.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// No driver offers an adapter.
    #[error("no graphics adapter found ({0}); install a Vulkan driver, or mesa-vulkan-drivers for a software adapter")]
    NoAdapter(String),
    /// The adapter is there but cannot do what the shaders need.
    #[error("graphics adapter '{adapter}' lacks {what}; choose another adapter or update its driver")]
    Unsuitable {
        /// Name that the driver reports.
        adapter: String,
        /// What is missing.
        what: String,
    },
    /// The driver refused to open the adapter.
    #[error("graphics adapter '{adapter}' cannot be opened: {reason}")]
    Device {
        /// Name that the driver reports.
        adapter: String,
        /// The driver's words.
        reason: String,
    },
    /// The window system and the adapter do not go together.
    #[error("the window cannot be drawn to: {0}")]
    Surface(String),
    /// The byte bound does not hold the model's coarsest level and tables.
    #[error(
        "the VRAM bound of {bound} bytes is too small: the coarsest level and the tables of this model need \
         {needed} bytes; raise --vram to at least that"
    )]
    BoundTooSmall {
        /// Bytes needed for the coarsest picture.
        needed: u64,
        /// The bound asked for, or what the adapter can bind at once.
        bound: u64,
    },
    /// A tile of the model is larger than the adapter's textures.
    #[error(
        "the model has tiles wider than the {limit} texels that this graphics adapter offers; bake it again with a \
         smaller --tile-size"
    )]
    TileTooLarge {
        /// Largest side, texels.
        limit: u32,
    },
    /// A read-back or a wait on the adapter failed.
    #[error("the graphics adapter stopped answering: {0}")]
    Lost(String),
}
