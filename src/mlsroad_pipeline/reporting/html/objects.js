
(() => {
  const data = JSON.parse(document.getElementById("object-data").textContent);
  const map = document.getElementById("map"), details = document.getElementById("object-details");
  const table = document.querySelector("#objects tbody"), form = document.getElementById("object-filters");
  const column = Object.fromEntries(data.columns.map(([name], k) => [name, k]));
  const whole = map.viewBox.baseVal, full = [whole.x, whole.y, whole.width, whole.height];
  let view = [...full], selected = null;
  const hidden = new Set();
  const text = value => value === null || value === "" ? "\u2013" :
    typeof value === "number" && !Number.isInteger(value) ? String(Math.round(value * 1000) / 1000) : String(value);
  const scale = () => { const box = map.getBoundingClientRect();
    return Math.max(view[2] / box.width, view[3] / box.height); };
  const scaleBar = () => {
    const bar = document.querySelector(".scale"), metres = scale() * 160, power = 10 ** Math.floor(Math.log10(metres));
    const length = Math.max(...[1, 2, 5].map(k => k * power).filter(k => k <= metres));
    bar.style.width = length / scale() + "px";
    bar.textContent = length >= 1000 ? length / 1000 + " km" : Number(length.toPrecision(1)) + " m";
  };
  const show = next => { view = next; map.setAttribute("viewBox", view.join(" ")); scaleBar(); };
  const zoom = (factor, x = view[0] + view[2] / 2, y = view[1] + view[3] / 2) => {
    if (!factor) return show([...full]);
    const k = Math.min(1, Math.max(8 / Math.max(full[2], full[3]), view[2] / factor / full[2])) * full[2] / view[2];
    show([x - (x - view[0]) * k, y - (y - view[1]) * k, view[2] * k, view[3] * k]);
  };
  const place = event => { const box = map.getBoundingClientRect(), s = scale();
    return [view[0] + view[2] / 2 + (event.clientX - box.left - box.width / 2) * s,
            view[1] + view[3] / 2 + (event.clientY - box.top - box.height / 2) * s]; };
  const nearest = event => {
    const [x, y] = place(event), reach = 14 * scale();
    let best = null, least = reach * reach;
    data.places.forEach(([u, v], i) => {
      const d = (u - x) ** 2 + (v - y) ** 2;
      if (d <= least && !hidden.has(data.rows[i][column.kind])) { least = d; best = i; }
    });
    return best;
  };
  const mark = i => {
    map.querySelectorAll(".chosen").forEach(old => old.classList.remove("chosen"));
    if (i !== null) map.querySelector(`[data-i="${i}"]`).classList.add("chosen");
  };
  const describe = i => {
    mark(i);
    if (i === null) return;
    const list = document.createElement("dl");
    data.columns.forEach(([, heading], k) => {
      const value = data.rows[i][k];
      if (value === null || value === "") return;
      const term = document.createElement("dt"), entry = document.createElement("dd");
      term.textContent = heading; entry.textContent = text(value);
      list.append(term, entry);
    });
    const title = document.createElement("h3");
    title.textContent = `${data.rows[i][column.object_id]} ${data.rows[i][column.class]}`;
    details.replaceChildren(title, list);
  };
  const choose = i => { selected = i; describe(i); };
  map.addEventListener("pointermove", event => {
    if (drag) { const s = scale();
      show([drag[2] - (event.clientX - drag[0]) * s, drag[3] - (event.clientY - drag[1]) * s, view[2], view[3]]);
      return; }
    const i = nearest(event);
    map.style.cursor = i === null ? "grab" : "pointer";
    if (i !== null) describe(i); else if (selected !== null) mark(selected);
  });
  let drag = null;
  map.addEventListener("pointerdown", event => { drag = [event.clientX, event.clientY, view[0], view[1]]; });
  window.addEventListener("pointerup", event => {
    if (drag && Math.hypot(event.clientX - drag[0], event.clientY - drag[1]) < 4) choose(nearest(event));
    drag = null;
  });
  map.addEventListener("wheel", event => {
    if (!event.ctrlKey && document.activeElement !== map) return;
    event.preventDefault(); zoom(event.deltaY < 0 ? 1.25 : 0.8, ...place(event));
  }, {passive: false});
  map.addEventListener("keydown", event => {
    const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (step) show([view[0] + step[0] * view[2] / 8, view[1] + step[1] * view[3] / 8, view[2], view[3]]);
    else if (event.key === "+" || event.key === "=") zoom(1.6);
    else if (event.key === "-") zoom(0.625);
    else if (event.key === "0") zoom(0);
    else return;
    event.preventDefault();
  });
  document.querySelectorAll("[data-zoom]").forEach(button =>
    button.addEventListener("click", () => zoom(Number(button.dataset.zoom))));
  document.querySelectorAll("input[data-layer]").forEach(input => input.addEventListener("change", () => {
    map.querySelectorAll(`[data-layer="${input.dataset.layer}"]`).forEach(part => {
      part.style.display = input.checked ? "" : "none"; });
  }));
  document.querySelectorAll("input[data-kind]").forEach(input => input.addEventListener("change", () => {
    const group = map.querySelector(`g[data-kind="${input.dataset.kind}"]`);
    group.style.display = input.checked ? "" : "none";
    const kind = data.kinds[Number(input.dataset.kind)];
    if (input.checked) hidden.delete(kind); else hidden.add(kind);
  }));
  scaleBar(); window.addEventListener("resize", scaleBar);
  const isServed = location.protocol.startsWith("http") && location.pathname === "/report";
  const toPage = target => {
    const link = document.createElement("a");
    link.href = `/go?${target}`; link.textContent = "open"; link.title = "Open it in the page of the survey";
    return link;
  };
  if (isServed) document.querySelectorAll("table:not(#objects)").forEach(other => {
    const heads = [...other.querySelectorAll("th")].map(head => head.textContent);
    const [line, x, y, z] = ["Line", "x", "y", "z"].map(name => heads.indexOf(name));
    if (line < 0 && Math.min(x, y, z) < 0) return;
    other.querySelectorAll("tbody tr").forEach(row => {
      const number = k => row.cells[k].textContent.replaceAll("\u202f", "");
      const target = line < 0 ? `place=${[x, y, z].map(number)}` : `line=${number(line)}`;
      row.cells[Math.max(line, 0)].append(" ", toPage(target));
    });
  });
  if (!form) return;
  let order = null, down = false, limit = 100;
  const more = document.getElementById("object-more"), count = document.getElementById("object-count");
  const compare = (a, b) => {
    const x = data.rows[a][order], y = data.rows[b][order];
    if (x === null || y === null) return (x === null) - (y === null) || a - b;
    const result = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
    return (down ? -result : result) || a - b;
  };
  const fill = () => {
    const kind = form.elements.kind.value;
    const low = Number(form.elements.low?.value ?? 0), high = Number(form.elements.high?.value ?? 1);
    const wanted = form.elements.text.value.trim().toLowerCase();
    let rows = data.rows.map((_, i) => i).filter(i => {
      const row = data.rows[i], score = row[column.score] ?? 0;
      return (!kind || row[column.kind] === kind) && score >= low && score <= high && (!wanted ||
        String(row[column.object_id]) === wanted || row[column.class].toLowerCase().includes(wanted));
    });
    if (order !== null) rows = rows.sort(compare);
    count.textContent = `${rows.length} of ${data.rows.length} objects`;
    more.hidden = rows.length <= limit;
    table.replaceChildren(...rows.slice(0, limit).map(i => {
      const line = document.createElement("tr");
      data.columns.forEach(([name], k) => {
        const entry = document.createElement("td"), value = data.rows[i][k];
        if (typeof value === "number") entry.className = "number";
        if (name === "object_id") {
          const button = document.createElement("button");
          button.type = "button"; button.textContent = text(value);
          button.setAttribute("aria-label", `Show object ${value} on the map`);
          button.addEventListener("click", () => {
            choose(i);
            const [x, y] = data.places[i], size = Math.min(full[2], 60), k = size / full[2];
            show([x - size / 2, y - full[3] * k / 2, size, full[3] * k]);
            map.scrollIntoView({block: "center"});
          });
          entry.append(button, ...(isServed ? [" ", toPage(`object=${value}`)] : []));
        } else entry.textContent = text(value);
        line.append(entry);
      });
      return line;
    }));
  };
  form.addEventListener("input", () => { limit = 100; fill(); });
  more.addEventListener("click", () => { limit += 400; fill(); });
  document.querySelectorAll("#objects thead button").forEach(button => button.addEventListener("click", () => {
    const k = Number(button.dataset.column);
    down = order === k && !down; order = k;
    document.querySelectorAll("#objects thead th").forEach(head => head.setAttribute("aria-sort", "none"));
    button.parentElement.setAttribute("aria-sort", down ? "descending" : "ascending");
    fill();
  }));
  fill();
})();
