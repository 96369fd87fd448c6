/* Tables that sort and filter, figures that open large and show their values and images, commands to copy, print. */
(() => {
  const make = (tag, fields = {}) => Object.assign(document.createElement(tag), fields);

  function value(row, column) {
    const text = row.cells[column].textContent.trim().replace(/−/g, "-").replace(/,/g, "");
    const number = parseFloat(text.replace(/^\+/, ""));
    return Number.isNaN(number) ? text.toLowerCase() : number;
  }

  function sort(table, head, column) {
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of table.tHead.querySelectorAll("th")) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const rows = [...table.tBodies[0].rows].map((row) => [value(row, column), row]);
    const order = (a, b) => (typeof a === typeof b ? (a < b ? -1 : a > b ? 1 : 0) : typeof a === "number" ? -1 : 1);
    rows.sort(([a], [b]) => (up ? order(a, b) : order(b, a)));
    table.tBodies[0].append(...rows.map(([, row]) => row));
  }

  function addTools(table) {
    [...table.tHead.rows[table.tHead.rows.length - 1].cells].forEach((head, column) => {
      const button = make("button", { type: "button", title: "sort by this column" });
      button.append(...head.childNodes);
      button.onclick = () => sort(table, head, column);
      head.append(button);
    });
    const rows = [...table.tBodies[0].rows];
    const count = make("span", { textContent: `${rows.length} rows` });
    const field = make("input", { type: "search", placeholder: "words in a row" });
    field.oninput = () => {
      const words = field.value.toLowerCase().split(/\s+/);
      const shown = rows.filter((row) => !(row.hidden = !words.every((w) => row.textContent.toLowerCase().includes(w))));
      count.textContent = `${shown.length} of ${rows.length} rows`;
    };
    const label = make("label", { textContent: "Filter " });
    label.append(field);
    const tools = make("div", { className: "tools" });
    tools.append(label, count);
    table.closest(".scroll").before(tools);
  }

  function enlarge(drawing) {
    const dialog = make("dialog", { className: "large" });
    const close = make("button", { type: "button", textContent: "Close" });
    close.onclick = () => dialog.close();
    dialog.onclose = () => dialog.remove();
    dialog.append(close, drawing.cloneNode(true));
    document.body.append(dialog);
    dialog.showModal();
  }

  function hint(event) {
    document.querySelector(".hint")?.remove();
    const point = event.target.closest?.("svg .value");
    if (!point) return;
    const box = make("div", { className: "hint" });
    const sheet = document.querySelector(".tiles");
    for (const tile of sheet && point.dataset.tiles ? point.dataset.tiles.split(" ") : []) {
      const picture = make("i");
      const across = Number(sheet.dataset.across);
      picture.style.background = sheet.style.backgroundImage;
      picture.style.backgroundPosition = `${-96 * (tile % across)}px ${-72 * Math.floor(tile / across)}px`;
      box.append(picture);
    }
    box.append(make("div", { textContent: point.querySelector("title").textContent }));
    (point.closest("dialog") ?? document.body).append(box);
    box.style.left = `${Math.max(4, Math.min(event.clientX + 12, innerWidth - box.offsetWidth - 4))}px`;
    box.style.top = `${Math.max(4, Math.min(event.clientY + 12, innerHeight - box.offsetHeight - 4))}px`;
  }

  function copy(button) {
    navigator.clipboard.writeText(button.previousElementSibling.textContent).then(() => (button.textContent = "copied"));
  }

  addEventListener("DOMContentLoaded", () => {
    document.querySelectorAll("table.results.many").forEach(addTools);
    document.addEventListener("pointerover", hint);
    document.addEventListener("click", (event) => {
      const drawing = event.target.closest("figure.figure .panels > svg, img.figure");
      if (event.target.matches("button.copy")) copy(event.target);
      else if (drawing && !drawing.closest("dialog")) enlarge(drawing);
    });
    // A page turned or scrolled by keys must not leave a hint behind.
    addEventListener("scroll", () => document.querySelector(".hint")?.remove(), { passive: true, capture: true });
  });
  addEventListener("beforeprint", () => document.querySelectorAll("details:not([open])").forEach((one) => (one.open = true)));
})();
