// Asks the server again and again, and puts what it says into the figures. The next
// question is asked only after the last answer is drawn: whoever is slow gets fewer.
"use strict";
const at = (id) => document.getElementById(id);
const LEAST = 70, SLOW = 400; // ms between pictures; between lines and spectra
let doc, live = true, chosen = null, wanted = null, drawn = 0, lost = 0, slow_due = 0;
let busy = false, last_names = "";

const model = (name) => doc.get_model_by_name(name);

function put(sources) {
  for (const [name, columns] of Object.entries(sources)) {
    const source = model(name);
    if (name === "image") {
      const pixels = source.data.image[0];
      columns.pixels.forEach((value, k) => { pixels[k] = value ?? NaN; }); // off the sheet
      model("colours").high = columns.high;
      source.change.emit();
    } else {
      source.data = columns;
    }
  }
}

// A millimetre is as long up as across.
function square() {
  const sheet = model("sheet-figure"), x = sheet.x_range, y = sheet.y_range;
  if (!square.ends) { square.ends = [x.start, x.end, y.start, y.end]; }
  const [x0, x1, y0, y1] = square.ends;
  const wide = sheet.inner_width, high = sheet.inner_height;
  if (!(wide > 0 && high > 0)) { return; }
  const scale = Math.max((x1 - x0) / wide, (y1 - y0) / high);
  const dx = scale * wide / 2, dy = scale * high / 2;
  if (Math.abs(x.end - x.start - 2 * dx) > 1e-6 * dx) { x.setv({ start: (x0 + x1) / 2 - dx, end: (x0 + x1) / 2 + dx }); }
  if (Math.abs(y.end - y.start - 2 * dy) > 1e-6 * dy) { y.setv({ start: (y0 + y1) / 2 - dy, end: (y0 + y1) / 2 + dy }); }
}

function tell(pairs) {
  const list = at("told");
  if (list.children.length !== 2 * pairs.length) {
    list.replaceChildren(...pairs.flatMap(() => [document.createElement("dt"), document.createElement("dd")]));
  }
  pairs.forEach(([name, text], k) => {
    list.children[2 * k].textContent = name;
    list.children[2 * k + 1].textContent = text;
  });
}

function flagged(flags) {
  at("flagged").replaceChildren(...flags.map(([name, text, level]) => {
    const line = document.createElement("p");
    line.className = "l" + level;
    line.textContent = text ? `${name}: ${text}` : name;
    return line;
  }));
}

function show(said) {
  put(said.sources);
  square();
  if (!live) {
    for (const id of ["volts", "spectrum", "choose"]) { at(id).classList.toggle("gone", !said.sources.volts); }
  }
  tell([...said.told, ["page", `${rate()} pictures/s`]]);
  flagged(said.flags);
  if (said.names && said.names.join() !== last_names) {
    last_names = said.names.join();
    model("names").factors = said.names;
  }
  if (said.times) { model("times").setv({ start: said.times[0], end: said.times[1] }); }
  if (said.thinned !== undefined) { at("thinned").textContent = said.thinned; }
  if (said.title) { at("title").textContent = said.title; document.title = said.title; }
  if (said.t !== undefined && document.activeElement !== at("scrub")) { at("scrub").value = said.t; }
  document.body.dataset.pictures = String(++drawn);
}

const recent = [];
function rate() {
  const now = performance.now();
  recent.push(now);
  while (now - recent[0] > 3000) { recent.shift(); }
  return recent.length < 2 ? "–" : ((recent.length - 1) / (now - recent[0]) * 1000).toFixed(1);
}

async function ask() {
  const now = performance.now(), words = new URLSearchParams({ electrode: at("electrode").value });
  if (live) {
    if (now > slow_due) { slow_due = now + SLOW; words.set("lines", "1"); }
  } else {
    const times = model("times");
    words.set("from", times.start); words.set("to", times.end);
    if (chosen !== null) { words.set("t", chosen); }
  }
  const answer = await fetch("data?" + words, { signal: AbortSignal.timeout(15000) });
  if (!answer.ok) { throw new Error((await answer.json()).error || answer.status); }
  show(await answer.json());
}

function wait(ms) { return new Promise((done) => setTimeout(done, ms)); }

async function loop() {
  for (;;) {
    const began = performance.now();
    try {
      const times = model("times");
      const asked = live ? "" : [chosen, times.start, times.end, at("electrode").value].join();
      if (live || asked !== wanted || performance.now() > slow_due) {
        if (!live) { slow_due = performance.now() + 1000; }
        wanted = asked;
        await ask();
        await new Promise(requestAnimationFrame);
      }
      lost = 0;
      at("title").classList.remove("over");
    } catch (error) {
      lost += 1;
      at("title").textContent = error.name === "TypeError" ? "no answer: the session has ended" : String(error.message);
      at("title").classList.add("over");
    }
    await wait(Math.max(LEAST - (performance.now() - began), lost ? 1000 : 5));
  }
}

async function mark(event) {
  event.preventDefault();
  if (at("mark").disabled || busy) { return; }
  busy = true;
  try {
    const answer = await fetch("mark", { method: "POST", body: at("text").value });
    const said = await answer.json();
    at("marked").textContent = answer.ok ? `marked ${said.t.toFixed(3)} s` : said.error;
    if (answer.ok) { at("text").value = ""; at("text").blur(); }
  } catch (error) {
    at("marked").textContent = "not marked: no answer";
  }
  busy = false;
}

async function main() {
  const page = await (await fetch("page.json")).json();
  await Bokeh.embed.embed_items(page.docs, page.items);
  doc = Bokeh.documents[0];
  live = page.live;
  at("electrode").max = page.electrodes - 1;
  at("mark").disabled = at("text").disabled = !page.marks;
  if (!page.marks) { at("mark").title = "nothing is recorded: a mark would go nowhere"; }
  if (!live) { at("marking").classList.add("gone"); } else { at("scrubbing").classList.add("gone"); }
  if (!page.marks && live) { at("marked").textContent = "nothing is recorded, so a mark goes nowhere"; }
  if (live || !page.residuals) { at("residuals").classList.add("gone"); }
  const scrub = at("scrub");
  [scrub.min, scrub.max] = page.span;
  const steer = () => { chosen = Number(scrub.value); };
  scrub.addEventListener("input", steer);
  scrub.addEventListener("change", () => scrub.blur());
  at("whole").addEventListener("click", () => model("times").setv({ start: page.span[0], end: page.span[1] }));
  if (!live) {
    for (const name of ["count", "strength", "flags"]) {
      model(name + "-figure").on_event("tap", (event) => { chosen = event.x; });
    }
  }
  at("marking").addEventListener("submit", mark);
  document.addEventListener("keydown", (event) => {
    if (event.key === "m" && !event.ctrlKey && !event.metaKey && !event.altKey && event.target.tagName !== "INPUT") { mark(event); }
  });
  await loop();
}

main();
