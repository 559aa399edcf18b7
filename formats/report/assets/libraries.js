export { select } from "d3-selection";
export { zoom, zoomIdentity } from "d3-zoom";
export { default as uPlot } from "uplot";
export { Renderer, Camera, Transform, Program, Mesh, Geometry, Orbit, Vec3 } from "ogl";
