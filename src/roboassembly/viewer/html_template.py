"""Additions to viser's page: `HEAD` goes before its scripts, `BODY` after them. Both are `string.Template` texts."""

HEAD = """<style>
#captions { position: fixed; top: max(0.8em, env(safe-area-inset-top)); right: 0.8em; max-width: calc(100vw - 3em);
  z-index: 2; pointer-events: none; padding: 0.45em 0.7em; border-radius: 0.4em; background: rgba(255,255,255,0.85);
  color: #24292f; font: 15px/1.35 system-ui, sans-serif; box-shadow: 0 1px 4px rgba(0,0,0,0.12); }
#captions b { display: block; }
/* viser's slider has no thumb and is thin: hard to hit with a finger. */
.mantine-Slider-root { --slider-thumb-size: 1.25rem !important; --slider-size: 0.55rem !important; }
.mantine-Slider-thumb { display: flex !important; }
.mantine-Slider-trackContainer { touch-action: none; }
</style>
<script>
(() => {
  // Choose a first camera that shows everything in this window; viser reads it from the address.
  const cameras = $cameras, target = $target;
  try {
    const query = new URLSearchParams(location.search);
    if (query.has("initialCameraPosition") && !query.has("fitted")) return;
    const aspect = innerWidth / Math.max(1, innerHeight);
    const camera = cameras.filter((c) => c[0] <= aspect).pop() || cameras[0];
    query.set("initialCameraPosition", camera.slice(1).join(","));
    query.set("initialCameraLookAt", target.join(","));
    query.set("initialCameraUp", "0,0,1");
    query.set("fitted", "1");
    history.replaceState(null, "", "?" + query);
  } catch (error) {
    // A page in a frame may not change its address; it keeps the recorded camera.
    console.info(error);
  }
})();
</script>
"""

BODY = """<div id="captions"><b>$name</b><span></span></div>
<script>
(() => {
  // The slider of the player holds the time.
  const captions = $captions;
  const text = document.querySelector("#captions span");
  const update = () => {
    const slider = document.querySelector("[role=slider]");
    const time = slider ? Number(slider.getAttribute("aria-valuenow")) : 0;
    let now = captions[0][1];
    for (const [start, caption] of captions) if (start <= time + 1e-3) now = caption;
    if (text.textContent !== now) text.textContent = now;
    requestAnimationFrame(update);
  };
  update();
})();
</script>
"""
