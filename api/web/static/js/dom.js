// Making elements. Text is always set as text, never as markup.

/**
 * An element.
 * @param {string} name a tag, with classes behind dots: "td.number"
 * @param {Object<string, any>|null} [attributes] functions are listeners ("onclick"), `false` and null leave one out
 * @param {...(Node|string|number|null|undefined|false|Array<any>)} children
 * @returns {HTMLElement}
 */
export function h(name, attributes, ...children) {
  const [tag, ...classes] = name.split(".");
  return /** @type {HTMLElement} */ (filled(document.createElement(tag), classes, attributes, children));
}

/**
 * An SVG element, as `h`.
 * @param {string} name
 * @param {Object<string, any>|null} [attributes]
 * @param {...any} children
 * @returns {SVGElement}
 */
export function s(name, attributes, ...children) {
  const [tag, ...classes] = name.split(".");
  return /** @type {SVGElement} */ (filled(document.createElementNS("http://www.w3.org/2000/svg", tag), classes, attributes, children));
}

/** @param {Element} node @param {string[]} classes @param {any} attributes @param {any[]} children @returns {Element} */
function filled(node, classes, attributes, children) {
  if (classes.length) node.setAttribute("class", classes.join(" "));
  for (const [key, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") node.addEventListener(key.replace(/^on/, ""), value);
    else node.setAttribute(key, value === true ? "" : String(value));
  }
  append(node, children);
  return node;
}

/** @param {Element} node @param {any[]} children */
function append(node, children) {
  for (const child of children.flat(Infinity)) {
    if (child === null || child === undefined || child === false) continue;
    node.append(child instanceof Node ? child : String(child));
  }
}

/** Put new children in place of all. @param {Element} node @param {...any} children */
export function fill(node, ...children) {
  node.replaceChildren();
  append(node, children);
}

/**
 * The element with an id, which must be there.
 * @param {string} id
 * @returns {any}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found;
}

/** A message with what to do about it. @param {"bad"|"caution"|"plain"} kind @param {string} text @param {string} [hint] @param {...any} more */
export function message(kind, text, hint = "", ...more) {
  return h(`div.message${kind === "plain" ? "" : `.${kind}`}`, null, h("p", null, h("strong", null, sentence(text))), hint ? h("p", null, hint) : null, more);
}

/** First letter large, a full stop at the end. @param {string} text */
export function sentence(text) {
  const large = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?…]$/.test(large) ? large : `${large}.`;
}

/** Whether a key is meant for what has the focus, and not for the page. @param {KeyboardEvent} event */
export function isTaken(event) {
  const { tagName, type } = /** @type {HTMLInputElement} */ (event.target);
  if (event.ctrlKey || event.metaKey || event.altKey || /^(SELECT|TEXTAREA)$/.test(tagName)) return true;
  return tagName === "INPUT" ? type !== "range" : /^(BUTTON|A|SUMMARY)$/.test(tagName) && [" ", "Enter"].includes(event.key);
}

/** Let a screen reader say something. @param {string} text */
export function say(text) {
  byId("said").textContent = text;
}

/** Show what went wrong, for as long as it takes to read. @param {unknown} error */
export function complain(error) {
  const known = /** @type {any} */ (error);
  if (known?.name === "AbortError") return;
  const shown = message("bad", known?.message ?? String(error), known?.hint);
  const close = h("button.small.quiet", { type: "button", onclick: () => shown.remove() }, "Close");
  shown.append(close);
  const place = byId("problems");
  while (place.childElementCount > 3) place.firstElementChild?.remove();
  place.append(shown);
}

/** Run something that may fail, and say so where it does. @template T @param {() => Promise<T>} work @returns {Promise<T|undefined>} */
export async function attempt(work) {
  try {
    return await work();
  } catch (error) {
    if (/** @type {any} */ (error)?.name === "AbortError") return undefined;
    complain(error);
    if (/** @type {any} */ (error)?.name !== "Problem") console.error(error);
    return undefined;
  }
}

/**
 * Open a dialog. Enter presses its submit button; buttons with `data-close` and Escape leave everything as it is.
 * @param {HTMLDialogElement} dialog
 * @returns {Promise<string>} the value of the button that submitted it, or "no"
 */
export function ask(dialog) {
  return new Promise((resolve) => {
    dialog.returnValue = "no";
    for (const button of dialog.querySelectorAll("[data-close]")) button.addEventListener("click", () => dialog.close("no"), { once: true });
    dialog.addEventListener("close", () => resolve(dialog.returnValue), { once: true });
    dialog.showModal();
  });
}
