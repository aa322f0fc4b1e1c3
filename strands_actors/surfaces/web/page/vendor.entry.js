export {AmbientLight, BufferAttribute, BufferGeometry, Color, DirectionalLight, GridHelper, Group, HemisphereLight, Mesh, MeshStandardMaterial, PerspectiveCamera, Quaternion, Scene, Vector3, WebGLRenderer, Box3} from "three";
export {OrbitControls} from "three/examples/jsm/controls/OrbitControls.js";
export {default as uPlot} from "uplot";
