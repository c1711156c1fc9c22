"use strict";
// Draws every plot of the page from the JSON beside it, and switches lines, views and colours.
(() => {
  const figures = [...document.querySelectorAll("figure.plot")];
  const switches = [...document.querySelectorAll("input[data-switch]")];
  // Buttons are listed, as the library has one by default that uploads the data.
  const options = {
    responsive: true,
    displaylogo: false,
    plotlyServerURL: "",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg" },
  };
  const axis = {
    gridcolor: "--rule",
    linecolor: "--ink",
    ticks: "outside",
    ticklen: 4,
    tickcolor: "--ink",
    showline: true,
    zeroline: false,
    title: { standoff: 8 },
  };
  // What all plots have in common; what one has of its own prevails.
  const template = {
    layout: {
      font: { family: "system-ui, sans-serif", size: 12, color: "--ink" },
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      hoverlabel: { bgcolor: "--paper", font: { color: "--ink" }, namelength: -1 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "--soft", activecolor: "--ink" },
      hovermode: "x unified",
      xaxis: axis,
      yaxis: axis,
    },
  };

  function styled({ data, layout }, name) {
    if (layout.legend) {
      const seen = new Set();
      for (const trace of data) {
        trace.legendgroup = trace.name;
        trace.showlegend = !seen.has(trace.name);
        seen.add(trace.name);
      }
    }
    // The buttons of plotly.js are in the upper margin, beside the caption.
    const margin = { l: 72, r: 12, t: 30, b: layout.legend ? 84 : 44 };
    // What the reader zoomed into stays when lines are switched, and says nothing of another view.
    const own = { margin, showlegend: Boolean(layout.legend), uirevision: name };
    return { data, layout: { template: structuredClone(template), ...own, ...layout } };
  }

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
      const number = chosen ? Number(chosen.value) : 0;
      const plain = styled(JSON.parse(views[number].textContent), `view ${number}`);
      const view = coloured(plain, getComputedStyle(document.documentElement));
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
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawAll(figures));

  // Paper is narrower than most screens, always white, and nobody can unfold anything on it.
  const folded = () => document.querySelectorAll("details:not([open])");
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...folded()];
    opened.forEach((part) => (part.open = true));
    document.documentElement.classList.add("print");
    for (const figure of figures) {
      const width = figure.closest(".matrix") ? 325 : 660;
      draw(figure);
      Plotly.relayout(figure.querySelector(".canvas"), { width });
    }
  });
  addEventListener("afterprint", () => {
    opened.forEach((part) => (part.open = false));
    document.documentElement.classList.remove("print");
    for (const figure of figures) {
      draw(figure);
      Plotly.relayout(figure.querySelector(".canvas"), { width: null, autosize: true });
    }
  });

  drawAll(figures).then(() => (document.documentElement.dataset.plots = "drawn"));
})();
