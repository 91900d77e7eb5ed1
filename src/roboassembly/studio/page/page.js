// The page around viser's scene: start buttons, time line, messages in the scene, files dropped on the page.
// It talks to the studio through two controls of viser's panel: it types commands into a text control, and reads what
// the studio shows in hidden elements. Text from the studio is only ever set as text, never as HTML.
(() => {
  "use strict";
  const MOST_BYTES = 50e6, MOST_FILES = 500, BETWEEN_COMMANDS = 70, BETWEEN_POINTERS = 100;
  const $ = (id) => document.getElementById(id);
  const studio = $("studio");
  let state = null, serial = 0, hovered = 0, pointer = null, waiting = [], sentAt = 0, touched = false, noticed = 0;

  // viser's client blocks the page while it starts, so it starts after the text is on the screen.
  let begun = false;
  function startViser() {
    if (begun) return;
    begun = true;
    const held = $("viser-client"), script = document.createElement("script");
    for (const { name, value } of held.attributes) if (name.startsWith("data-")) script.setAttribute(name, value);
    script.textContent = held.textContent;
    held.remove();
    document.head.append(script);
  }
  requestAnimationFrame(() => setTimeout(startViser, 0));
  setTimeout(startViser, 300); // a hidden page gets no frames

  // Commands

  function row(uuid) {
    const label = document.querySelector(`label[for="${CSS.escape(uuid)}"]`), own = $(uuid);
    if (label) return label.closest(".mantine-Flex-root").parentElement;
    return own && own.parentElement;
  }
  function say(command) {
    if (command.startsWith("pointer")) waiting = waiting.filter((c) => !c.startsWith("pointer"));
    if (!waiting.includes(command)) waiting.push(command);
    flush();
  }
  function flush() {
    const link = state && row(state.link), input = link && link.querySelector("input");
    if (!input || !waiting.length) return;
    // viser's page sends only the last of the changes that come within 50 ms.
    const wait = sentAt + BETWEEN_COMMANDS - performance.now();
    if (wait > 0) { setTimeout(flush, wait); return; }
    sentAt = performance.now();
    const command = waiting.shift();
    if (command.startsWith("pointer")) hovered = serial + 1;
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, `${++serial} ${command}`);
    input.dispatchEvent(new Event("input", { bubbles: true }));
    if (waiting.length) setTimeout(flush, BETWEEN_COMMANDS);
  }

  // What the studio shows

  let seen = {};
  function changed(id) {
    const element = $(id), text = element ? element.dataset.json : undefined;
    if (text === undefined || text === seen[id]) return null;
    seen[id] = text;
    return JSON.parse(text);
  }
  function look() {
    const next = changed("studio-state"), steps = changed("studio-pictures"), name = changed("studio-hover");
    if (next) { state = next; show(); }
    if (steps) showSteps(steps);
    if (state && (next || steps)) markStep();
    if (name) showName(name);
    flush();
  }
  new MutationObserver(look).observe($("root"), {
    childList: true, subtree: true, attributes: true, attributeFilter: ["data-json"],
  });

  function show() {
    studio.dataset.ready = "yes";
    studio.dataset.mode = state.mode;
    $("studio-piece").textContent = state.piece;
    for (const uuid of state.hidden) { const found = row(uuid); if (found) found.classList.add("studio-hidden"); }
    const busy = state.busy;
    $("studio-busy").classList.toggle("on", Boolean(busy));
    if (busy) {
      $("studio-doing").textContent = busy.text;
      const bar = document.querySelector("#studio-busy progress");
      if (busy.percent === null) bar.removeAttribute("value"); else bar.value = busy.percent;
      $("studio-cancel").hidden = !busy.cancel;
    }
    if (state.notice && state.notice.number !== noticed) {
      noticed = state.notice.number;
      notice(state.notice.kind, state.notice.title, state.notice.text);
    }
    if (!state.notice) $("studio-notice").classList.remove("on");
    $("studio-undo").disabled = !state.merges;
    $("studio-play").textContent = state.is_playing ? "❚❚" : "▶";
    $("studio-play").setAttribute("aria-label", state.is_playing ? "Stop" : "Play the steps");
    for (const button of document.querySelectorAll("#studio-start button")) button.classList.remove("waits");
  }
  function notice(kind, title, text) {
    const box = $("studio-notice");
    box.className = `on ${kind}`;
    box.querySelector("b").textContent = title;
    box.querySelector("p").textContent = text;
  }
  function showSteps(steps) {
    const list = $("studio-steps");
    $("studio-line").classList.toggle("empty", steps.length < 2);
    list.replaceChildren(...steps.map((step, index) => {
      const item = document.createElement("li"), button = document.createElement("button");
      button.type = "button";
      button.dataset.say = `step ${index}`;
      button.title = step.text;
      let picture;
      if (step.picture.startsWith("data:image/jpeg;base64,")) {
        picture = document.createElement("img");
        picture.src = step.picture;
        picture.alt = "";
      } else {
        picture = document.createElement("span");
        picture.className = "blank";
      }
      const number = document.createElement("i"), text = document.createElement("small");
      number.textContent = index || "start";
      text.textContent = step.text;
      button.append(picture, number, text);
      item.append(button);
      return item;
    }));
  }
  function markStep() {
    document.querySelectorAll("#studio-steps button").forEach((button, index) => {
      const now = index === state.step;
      if (now === button.hasAttribute("aria-current")) return;
      if (!now) { button.removeAttribute("aria-current"); return; }
      button.setAttribute("aria-current", "step");
      const list = $("studio-steps");
      list.scrollLeft = button.offsetLeft - 0.5 * (list.clientWidth - button.clientWidth);
    });
  }
  function showName(name) {
    const box = $("studio-name");
    box.classList.toggle("on", Boolean(name.text && pointer && name.serial === hovered));
    if (!box.classList.contains("on")) return;
    box.textContent = name.text;
    const left = Math.min(pointer.x + 14, studio.clientWidth - box.offsetWidth - 4);
    box.style.transform = `translate(${left}px, ${Math.max(4, pointer.y - 34)}px)`;
  }

  // The scene

  let canvas = null;
  function place() {
    const found = document.querySelector("#root canvas[data-engine]");
    if (!found) return;
    const box = found.getBoundingClientRect(), root = document.documentElement.style;
    for (const side of ["left", "top", "width", "height"]) root.setProperty(`--studio-${side}`, `${box[side]}px`);
    if (found === canvas) return;
    canvas = found;
    new ResizeObserver(place).observe(canvas);
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerleave", () => { pointer = null; $("studio-name").classList.remove("on"); });
    for (const kind of ["pointerdown", "wheel"]) canvas.addEventListener(kind, touch, { passive: true });
  }
  setInterval(place, 500);
  addEventListener("resize", place);

  let movedAt = 0, later = 0;
  function move(event) {
    if (event.pointerType === "touch" || event.buttons) { pointer = null; $("studio-name").classList.remove("on"); return; }
    const box = canvas.getBoundingClientRect();
    pointer = { x: event.clientX - box.left, y: event.clientY - box.top, w: box.width, h: box.height };
    clearTimeout(later);
    later = setTimeout(ask, Math.max(0, movedAt + BETWEEN_POINTERS - performance.now()));
  }
  function ask() {
    if (!pointer || !state) return;
    movedAt = performance.now();
    const share = (a, b) => Math.min(0.9999, Math.max(0, a / b)).toFixed(4);
    say(`pointer ${share(pointer.x, pointer.w)} ${share(pointer.y, pointer.h)}`);
  }
  function touch() {
    if (touched || !state || state.mode !== "opening") return;
    touched = true;
    say("touch");
  }
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) say("touch");
  // Without a graphics card, a picture that turns keeps the processor busy: then there are few frames, or none.
  let drawn = 0, gaps = [];
  function pace(now) {
    if (!state || state.mode !== "opening" || touched) { drawn = 0; requestAnimationFrame(pace); return; }
    if (drawn) gaps.push(now - drawn);
    drawn = now;
    if (gaps.length >= 12 || gaps.reduce((a, b) => a + b, 0) > 2500) {
      const middle = gaps.sort((a, b) => a - b)[gaps.length >> 1];
      if (middle > 1000) touch(); else if (middle > 100) say("slow");
      gaps = [];
    }
    requestAnimationFrame(pace);
  }
  requestAnimationFrame(pace);

  // Buttons

  function openTab(name) {
    for (const tab of document.querySelectorAll("#root [role=tab]"))
      if (tab.textContent.trim() === name) {
        for (const kind of ["pointerdown", "pointerup"])
          tab.dispatchEvent(new PointerEvent(kind, { bubbles: true, button: 0, pointerId: 1, isPrimary: true }));
        tab.click();
      }
  }
  document.addEventListener("click", (event) => {
    const button = event.target.closest ? event.target.closest("#studio button") : null;
    if (!button) return;
    const data = button.dataset;
    if (data.say) {
      if (!state) button.classList.add("waits");
      say(data.say);
      if (data.say === "steps") openTab("Steps");
    }
    if (data.open === "own") { touch(); $("studio-own").showModal(); }
    if (data.close === "own") $("studio-own").close();
    if (data.close === "notice") { $("studio-notice").classList.remove("on"); say("read"); }
    if (data.pick) $(`studio-${data.pick}`).click();
  });

  // Files

  for (const kind of ["files", "folder"])
    $(`studio-${kind}`).addEventListener("change", (event) => {
      const chosen = [...event.target.files].map((file) => [file.webkitRelativePath || file.name, file]);
      event.target.value = "";
      bring(chosen);
    });
  let depth = 0;
  const hasFiles = (event) => event.dataTransfer && [...event.dataTransfer.types].includes("Files");
  addEventListener("dragenter", (event) => { if (hasFiles(event)) { depth += 1; $("studio-drop").classList.add("on"); } });
  addEventListener("dragleave", (event) => {
    if (hasFiles(event) && --depth <= 0) { depth = 0; $("studio-drop").classList.remove("on"); }
  });
  addEventListener("dragover", (event) => { if (hasFiles(event)) event.preventDefault(); });
  addEventListener("drop", async (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    depth = 0;
    $("studio-drop").classList.remove("on");
    // The entries are gone after the first wait.
    const entries = [...event.dataTransfer.items].map((i) => i.webkitGetAsEntry && i.webkitGetAsEntry());
    const plain = [...event.dataTransfer.files].map((file) => [file.name, file]);
    if (!entries.some((entry) => entry && entry.isDirectory)) return bring(plain);
    const found = [];
    try {
      for (const entry of entries) if (entry) await collect(entry, "", found);
    } catch (error) {
      notice("bad", "The files cannot be read", String(error.message || error));
      return;
    }
    bring(found);
  });
  async function collect(entry, folder, found) {
    if (found.length > MOST_FILES) return;
    if (entry.isFile) {
      found.push([folder + entry.name, await new Promise((done, fail) => entry.file(done, fail))]);
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, fail) => reader.readEntries(done, fail));
      if (!some.length) return;
      for (const inner of some) await collect(inner, `${folder}${entry.name}/`, found);
    }
  }
  async function bring(all) {
    if ($("studio-own").open) $("studio-own").close();
    const files = all.filter(([path]) => !path.split("/").some((part) => part.startsWith(".")));
    const total = files.reduce((sum, [, file]) => sum + file.size, 0);
    const refuse = (text) => notice("bad", "These files cannot be opened", text);
    if (!files.length) return refuse("There is no file in it.");
    if (files.length > MOST_FILES) return refuse(`There are more than ${MOST_FILES} files. Drop one piece of furniture.`);
    if (total > MOST_BYTES) return refuse(`They have ${(total / 1e6).toFixed(0)} MB together; at most 50 MB are allowed.`);
    const single = files.length === 1 && !files[0][0].includes("/");
    let file = files[0][1];
    if (!single) {
      const top = files[0][0].includes("/") ? files[0][0].split("/")[0] : "my furniture";
      try {
        file = new File([await archive(files)], `${top}.zip`, { type: "application/zip" });
      } catch (error) {
        return refuse(String(error.message || error));
      }
    }
    const input = state && $(`file_upload_${state.upload}`);
    if (!input) return refuse("The studio is not ready yet. Try again in a moment.");
    const moved = new DataTransfer();
    moved.items.add(file);
    input.files = moved.files;
    input.dispatchEvent(new Event("change", { bubbles: true }));
  }

  // A ZIP archive without compression: https://pkware.cachefly.net/webdocs/casestudies/APPNOTE.TXT

  const TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
    return n >>> 0;
  });
  function crc32(bytes) {
    let crc = 0xffffffff;
    for (const byte of bytes) crc = TABLE[(crc ^ byte) & 255] ^ (crc >>> 8);
    return (crc ^ 0xffffffff) >>> 0;
  }
  function header(sizes, values) {
    const view = new DataView(new ArrayBuffer(sizes.reduce((a, b) => a + b)));
    let at = 0;
    sizes.forEach((size, k) => {
      if (size === 2) view.setUint16(at, values[k], true); else view.setUint32(at, values[k], true);
      at += size;
    });
    return new Uint8Array(view.buffer);
  }
  async function archive(files) {
    const bodies = [], entries = [], UTF8 = 0x800, DAY = 33; // 1 January 1980
    let at = 0, listed = 0;
    for (const [path, file] of files) {
      const name = new TextEncoder().encode(path), content = new Uint8Array(await file.arrayBuffer());
      const facts = [20, UTF8, 0, 0, DAY, crc32(content), content.length, content.length, name.length, 0];
      const local = header([4, 2, 2, 2, 2, 2, 4, 4, 4, 2, 2], [0x04034b50, ...facts]);
      const entry = header([4, 2, 2, 2, 2, 2, 2, 4, 4, 4, 2, 2, 2, 2, 2, 4, 4],
        [0x02014b50, 20, ...facts, 0, 0, 0, 0, at]);
      bodies.push(local, name, content);
      entries.push(entry, name);
      at += local.length + name.length + content.length;
      listed += entry.length + name.length;
    }
    const end = header([4, 2, 2, 2, 2, 4, 4, 2], [0x06054b50, 0, 0, files.length, files.length, listed, at, 0]);
    return new Blob([...bodies, ...entries, end]);
  }
})();
