// node play.mjs MODULES MODEL.vrm CLIP.vrma TIME... : checks the clip with Khronos' validator, plays it on the model
// with three-vrm, and prints where the humanoid's bones are at these times, in metres of the scene.
import fs from "node:fs";
import path from "node:path";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [modules, model, clip, ...times] = process.argv.slice(2);
const find = createRequire(path.join(modules, "here.js"));
const load = async (name) => import(pathToFileURL(path.join(modules, "node_modules", name)));
globalThis.self = globalThis; // GLTFLoader was written for browsers
const THREE = await load("three/build/three.module.js");
const { GLTFLoader } = await load("three/examples/jsm/loaders/GLTFLoader.js");
const { VRMLoaderPlugin } = await load("@pixiv/three-vrm/lib/three-vrm.module.js");
const { VRMAnimationLoaderPlugin, createVRMAnimationClip } = await load(
  "@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js",
);

const read = async (file) => {
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMLoaderPlugin(parser));
  loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
  const bytes = fs.readFileSync(file);
  return loader.parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), "");
};
const { vrm } = (await read(model)).userData;
const [animation] = (await read(clip)).userData.vrmAnimations;
const played = createVRMAnimationClip(animation, vrm);
const mixer = new THREE.AnimationMixer(vrm.scene);
const action = mixer.clipAction(played);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const shown = times.map((time) => {
  mixer.setTime(Number(time));
  vrm.update(0);
  vrm.scene.updateMatrixWorld(true);
  const places = {};
  for (const [name, bone] of Object.entries(vrm.humanoid.humanBones)) {
    places[name] = bone.node.getWorldPosition(new THREE.Vector3()).toArray();
    for (const child of bone.node.children) {
      if (child.name.endsWith("Tip")) places[child.name] = child.getWorldPosition(new THREE.Vector3()).toArray();
    }
  }
  return places;
});
const { issues } = await find("gltf-validator").validateBytes(new Uint8Array(fs.readFileSync(clip)));
process.stdout.write(JSON.stringify({ issues, duration: played.duration, shown }));
