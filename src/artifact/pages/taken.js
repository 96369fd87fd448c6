(function () {
  const page = document.currentScript.closest(".taken");
  const data = JSON.parse(page.querySelector("script[type='application/json']").textContent);
  const dataset = page.querySelector("select.dataset");
  const method = page.querySelector("select.method");
  const parts = [
    ["query", (one) => "Query (" + one.query_condition + ")", () => ""],
    ["positive", (one) => "Should have won (" + one.database_condition + ")", () => ""],
    ["distractor", (one) => "Won: a distractor (" + one.query_condition + ")", (one) => one.note],
  ];
  let at = 0;

  function fill(select, name) {
    const values = [...new Set(data.cases.map((one) => one[name]))];
    for (const value of ["all", ...values]) {
      select.add(new Option(value, value));
    }
    select.addEventListener("change", () => { at = 0; show(); });
  }

  function chosen() {
    return data.cases.filter((one) =>
      (dataset.value === "all" || one.dataset === dataset.value) && (method.value === "all" || one.method === method.value));
  }

  function line(text) {
    const element = document.createElement("div");
    element.textContent = text;
    return element;
  }

  function show() {
    const cases = chosen();
    const triple = page.querySelector(".triple");
    triple.replaceChildren();
    if (!cases.length) {
      page.querySelector(".count").textContent = "No query is taken here.";
      return;
    }
    at = (at + cases.length) % cases.length;
    const one = cases[at];
    page.querySelector(".count").textContent = (at + 1) + " of " + cases.length + ": " + one.dataset + ", " + one.method +
      " (of " + one.of + " queries that it loses)";
    for (const [part, title, note] of parts) {
      const figure = document.createElement("figure");
      const image = document.createElement("img");
      image.src = "data:image/jpeg;base64," + data.images[one[part]];
      image.alt = title(one) + ", " + one[part + "_file"];
      const caption = document.createElement("figcaption");
      caption.append(line(title(one)), line(one[part + "_file"]), line(note(one)));
      figure.className = part;
      figure.append(image, caption);
      triple.append(figure);
    }
  }

  function step(by) {
    at += by;
    show();
  }

  fill(dataset, "dataset");
  fill(method, "method");
  page.querySelector(".previous").addEventListener("click", () => step(-1));
  page.querySelector(".next").addEventListener("click", () => step(1));
  document.addEventListener("keydown", (event) => {
    if (event.target.closest("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) {
      return;
    }
    if (event.key === "ArrowRight" || event.key === "ArrowLeft") {
      step(event.key === "ArrowRight" ? 1 : -1);
      event.preventDefault();
    }
  });
  show();
})();
