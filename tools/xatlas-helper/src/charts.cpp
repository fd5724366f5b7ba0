// xatlas' chart cutter behind one C function. xatlas itself is compiled into this file: its public interface gives
// texture coordinates only after packing, which stretches charts to whole texels and takes longer than the cutting.
// So the charts are read where xatlas keeps them; the crate's version is pinned for that reason.
#define XA_MULTITHREADED 0 // pb-bake starts one helper per thread
#include "xatlas.cpp"

#include <stdarg.h>
#if defined(__unix__)
#include <sys/resource.h>
#endif

// Standard output belongs to the protocol.
static int printToStderr(const char *format, ...)
{
	va_list arguments;
	va_start(arguments, format);
	const int written = vfprintf(stderr, format, arguments);
	va_end(arguments);
	return written;
}

// Bounds the memory of this process, bytes.
extern "C" void pb_limit_memory(uint64_t bytes)
{
#if defined(__unix__)
	struct rlimit limit;
	limit.rlim_cur = limit.rlim_max = (rlim_t)bytes;
	setrlimit(RLIMIT_AS, &limit);
#else
	(void)bytes;
#endif
}

// positions: 3 * vertexCount, triangles: 3 * triangleCount, indices below vertexCount.
// chartOf: triangleCount, UINT32_MAX for triangles that xatlas leaves out (no area). uv: 6 * triangleCount.
// Returns the number of charts, or -1.
extern "C" int32_t pb_charts(const float *positions, uint32_t vertexCount, const uint32_t *triangles, uint32_t triangleCount,
                             float maxCost, uint32_t maxIterations, uint32_t *chartOf, float *uv)
{
	using namespace xatlas;
	SetPrint(printToStderr, false);
	Atlas *atlas = Create();
	MeshDecl mesh;
	mesh.vertexPositionData = positions;
	mesh.vertexPositionStride = 3 * sizeof(float);
	mesh.vertexCount = vertexCount;
	mesh.indexData = triangles;
	mesh.indexCount = 3 * triangleCount;
	mesh.indexFormat = IndexFormat::UInt32;
	if (AddMesh(atlas, mesh) != AddMeshError::Success) {
		Destroy(atlas);
		return -1;
	}
	ChartOptions options;
	options.maxCost = maxCost;
	options.maxIterations = maxIterations;
	options.fixWinding = true;
	ComputeCharts(atlas, options);
	for (uint32_t t = 0; t < triangleCount; t++)
		chartOf[t] = UINT32_MAX;
	const internal::param::Atlas &cut = ((Context *)atlas)->paramAtlas;
	uint32_t count = 0;
	for (uint32_t g = 0; g < cut.chartGroupCount(0); g++) {
		const internal::param::ChartGroup *group = cut.chartGroupAt(0, g);
		for (uint32_t c = 0; c < group->chartCount(); c++, count++) {
			const internal::param::Chart *chart = group->chartAt(c);
			const internal::Mesh *flat = chart->unifiedMesh();
			for (uint32_t f = 0; f < flat->faceCount(); f++) {
				const uint32_t t = chart->mapFaceToSourceFace(f);
				if (t >= triangleCount)
					continue;
				chartOf[t] = count;
				for (uint32_t k = 0; k < 3; k++) {
					const internal::Vector2 &corner = flat->texcoord(flat->vertexAt(f * 3 + k));
					uv[6 * t + 2 * k] = corner.x;
					uv[6 * t + 2 * k + 1] = corner.y;
				}
			}
		}
	}
	Destroy(atlas);
	return (int32_t)count;
}
