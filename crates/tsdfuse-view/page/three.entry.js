export { WebGLRenderer, WebGLRenderTarget, DepthTexture, FloatType, Scene, PerspectiveCamera, OrthographicCamera, PlaneGeometry, BufferGeometry, BufferAttribute, Mesh, ShaderMaterial, Points, PointsMaterial, Line, LineBasicMaterial, Vector2, Vector3, Box3, Raycaster, DoubleSide, GLSL3, Group, LinearSRGBColorSpace, NoBlending } from "three";
export { Matrix4, Sphere } from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { TilesRenderer } from "3d-tiles-renderer";
