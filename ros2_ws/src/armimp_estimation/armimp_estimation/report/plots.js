"use strict";
// Draws every plot of the page from the JSON beside it, and switches lines, views and colours.
(() => {
  const figures = [...document.querySelectorAll("figure.plot")];
  const switches = [...document.querySelectorAll("input[data-switch]")];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  // Buttons are listed, as the library has one by default that uploads the data.
  const options = {
    responsive: true,
    displaylogo: false,
    plotlyServerURL: "",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg" },
  };

  // Colours are names of variables of the style, perhaps with their share: --ink, --ink/0.2.
  function coloured(value, style) {
    if (typeof value === "string" && value.startsWith("--")) {
      const [name, share] = value.split("/");
      const colour = style.getPropertyValue(name).trim();
      const hex = share ? Math.round(255 * Number(share)).toString(16).padStart(2, "0") : "";
      return colour + hex;
    }
    if (Array.isArray(value)) return value.map((one) => coloured(one, style));
    if (value && typeof value === "object") {
      for (const key of Object.keys(value)) value[key] = coloured(value[key], style);
    }
    return value;
  }

  function draw(figure) {
    const canvas = figure.querySelector(".canvas");
    const chosen = figure.querySelector("select, input[type=radio]:checked");
    const views = figure.querySelectorAll("script[type='application/json']");
    const off = new Set(switches.filter((box) => !box.checked).map((box) => box.dataset.switch));
    try {
      const text = views[chosen ? Number(chosen.value) : 0].textContent;
      const view = coloured(JSON.parse(text), getComputedStyle(document.documentElement));
      for (const trace of view.data) {
        trace.visible = !(trace.meta || []).some((tag) => off.has(tag));
      }
      return Plotly.react(canvas, view.data, view.layout, options);
    } catch (error) {
      console.error(figure.id, error);
      canvas.textContent = "This plot could not be drawn.";
      return Promise.resolve();
    }
  }

  // One at a time, so that the page answers while many are drawn.
  async function drawAll(some) {
    for (const figure of some) {
      await draw(figure);
      await new Promise((resume) => setTimeout(resume));
    }
  }

  for (const box of switches) {
    box.addEventListener("change", () => {
      const twins = switches.filter((other) => other.dataset.switch === box.dataset.switch);
      twins.forEach((other) => (other.checked = box.checked));
      drawAll(figures.filter((figure) => figure.closest(".matrix")));
    });
  }
  for (const figure of figures) {
    figure.addEventListener("change", () => draw(figure));
  }
  dark.addEventListener("change", () => drawAll(figures));

  // Paper is narrower than most screens, always white, and nobody can unfold anything on it.
  const folded = () => document.querySelectorAll("details:not([open])");
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...folded()];
    opened.forEach((part) => (part.open = true));
    for (const figure of figures) {
      const width = figure.closest(".matrix") ? 325 : 660;
      Plotly.relayout(figure.querySelector(".canvas"), { width });
    }
  });
  addEventListener("afterprint", () => {
    opened.forEach((part) => (part.open = false));
    for (const figure of figures) {
      Plotly.relayout(figure.querySelector(".canvas"), { width: null, autosize: true });
    }
  });

  drawAll(figures).then(() => (document.documentElement.dataset.plots = "drawn"));
})();
