# All commands of the project. Each is a script that also runs without just.

# list the recipes
default:
    @just --list

# build everything, run all tests, format and lints
test:
    tools/test

# bake two scans and fly around them without a window
demo:
    tools/demo

# speed of pb-bake beside the meshopt crate's chain of four simplifications
bench-bake *MESHES:
    tools/bench-bake {{MESHES}}

# bytes of each stream of an archive per triangle of its mesh
bench-size *MESHES:
    tools/bench-size {{MESHES}}

# triangles per second from an archive's chunks to arrays for the adapter, on one core
bench-decode *ARCHIVES:
    tools/bench-decode {{ARCHIVES}}

# memory of bakes of generated meshes of 16 and 64 million triangles under bounds; or of the sizes given, in millions
bench-memory *MILLIONS:
    tools/bench-memory {{MILLIONS}}

# memory of a bake of many large atlases under a bound
bench-atlases *ARGS:
    tools/bench-atlases {{ARGS}}

# how true the remaining time is that pb-bake shows
bench-progress *MESHES:
    tools/bench-progress {{MESHES}}

# distance of every level to its input, beside meshopt at the same vertex counts
bench-levels *MESHES:
    tools/bench-levels {{MESHES}}

# each textured model beside a renderer of its source at full resolution: FLIP, errors, sizes
bench-textures *MODELS:
    tools/bench-textures {{MODELS}}

# slow flights onto textured scans: changes between frames beside those of a renderer of the source
bench-pops *MODELS:
    tools/bench-pops {{MODELS}}

# what a bake of a 16384 x 16384 image holds in memory, per texel of the image: PNG, JPEG, TIFF
bench-texture-memory *KINDS:
    tools/bench-texture-memory {{KINDS}}

# charts of the built-in method beside those of xatlas: number, seams, fill, stretch, speed
bench-charts *MESHES:
    tools/bench-charts {{MESHES}}

# an archive's chunks read at positions beside a map of it, cold and warm
bench-reads *ARGS:
    tools/bench-reads {{ARGS}}

# time of a frame's work on the processor, by number of clusters: selection, cache, commands
bench-frame *ARGS:
    tools/bench-frame {{ARGS}}

# scenes of a million loose parts and of ten thousand instances: baked and flown
bench-parts *ARGS:
    tools/bench-parts {{ARGS}}

# frame times on this machine's adapter
bench-view *ARGS:
    tools/bench-view {{ARGS}}

# the same at 1920x1080, for machines with a GPU
bench-gpu *ARGS:
    tools/bench-view {{ARGS}} --size 1920x1080

# frames of a window while it loads, and after
bench-window *ARGS:
    tools/bench-window {{ARGS}}

# memory of a process that flies for 30 minutes, and its bounds
bench-soak *ARGS:
    tools/bench-soak {{ARGS}}

# the paper's figures 6 and 8 from a generated colonnade, as reports and plots in out/figures
figures *ARGS:
    tools/figures {{ARGS}}

# from a cut to full detail, in a generated colonnade from a solid state disk
bench-cuts *ARGS:
    tools/bench-cuts {{ARGS}}

# each fuzz target for SECONDS
fuzz SECONDS="600":
    tools/fuzz-all {{SECONDS}}

# build the xatlas helper of pb-bake --charts xatlas, and copy it to FOLDER if one is given
xatlas-helper *FOLDER:
    tools/xatlas-helper/build {{FOLDER}}
