// Draws views. A view is a tree of plain objects; the next tree changes only what differs in the page, so that focus,
// selection and a button under a finger stay as they are. Text is never parsed as HTML.

const SVG = "http://www.w3.org/2000/svg";
const PROPERTIES = new Set(["value", "checked", "disabled", "open", "hidden", "selected", "indeterminate"]);

/**
 * @typedef {{ tag: string, props: Record<string, any>, children: Child[] }} View
 * @typedef {View | string} Child
 * @typedef {Child | number | boolean | null | undefined} Given
 */

/** @type {WeakMap<Node, View>} */
const drawn = new WeakMap();
/** @type {WeakMap<Node, Map<string, (event: Event) => void>>} */
const handlers = new WeakMap();

/**
 * An element to be drawn. `key` tells siblings apart; `on…` are handlers; objects and functions are set as properties
 * (of the panel's own elements); `style` is an object of CSS properties.
 * @param {string} tag
 * @param {Record<string, any> | null} [props]
 * @param {...(Given | Given[] | Given[][])} children
 * @returns {View}
 */
export function h(tag, props, ...children) {
  return { tag, props: props ?? {}, children: listed(children) };
}

/** @param {any[]} children @returns {Child[]} */
function listed(children) {
  return children.flat(3)
    .filter((child) => child !== null && child !== undefined && child !== false && child !== true && child !== "")
    .map((child) => (typeof child === "object" ? child : String(child)));
}

/**
 * Make `parent` show these views.
 * @param {Element} parent
 * @param {Given | Given[]} views
 */
export function render(parent, views) {
  place(parent, listed([views]));
}

/** @param {Element} parent @param {Child[]} wanted */
function place(parent, wanted) {
  /** @type {Map<string, ChildNode>} */
  const keyed = new Map();
  /** @type {ChildNode[]} */
  const free = [];
  for (const node of parent.childNodes) {
    const key = drawn.get(node)?.props.key;
    if (key === undefined) free.push(node);
    else keyed.set(`${key}`, node);
  }
  let before = parent.firstChild;
  for (const child of wanted) {
    const node = fitting(child, keyed, free, parent);
    if (node === before) before = before.nextSibling;
    else parent.insertBefore(node, before);
  }
  while (before) {
    const next = before.nextSibling;
    before.remove();
    before = next;
  }
}

/**
 * A node that shows `child`: one that is there already if there is one of its key, or else of its kind.
 * @param {Child} child
 * @param {Map<string, ChildNode>} keyed
 * @param {ChildNode[]} free
 * @param {Element} parent
 * @returns {ChildNode}
 */
function fitting(child, keyed, free, parent) {
  if (typeof child === "string") {
    const at = free.findIndex((node) => node.nodeType === Node.TEXT_NODE);
    const node = at < 0 ? document.createTextNode(child) : /** @type {Text} */ (free.splice(at, 1)[0]);
    if (node.data !== child) node.data = child;
    return node;
  }
  const { key } = child.props;
  const old = key === undefined
    ? free.find((node) => drawn.get(node)?.tag === child.tag)
    : keyed.get(`${key}`);
  if (old && drawn.get(old)?.tag === child.tag) {
    if (key === undefined) free.splice(free.indexOf(old), 1);
    update(/** @type {Element} */ (old), child);
    return old;
  }
  const inside = child.tag === "svg" || (parent.namespaceURI === SVG && parent.tagName !== "foreignObject");
  const made = inside ? document.createElementNS(SVG, child.tag) : document.createElement(child.tag);
  update(made, child);
  return made;
}

/** @param {Element} node @param {View} view */
function update(node, view) {
  const before = drawn.get(node)?.props ?? {};
  for (const name of Object.keys(before)) if (!(name in view.props)) set(node, name, undefined, before[name]);
  for (const [name, value] of Object.entries(view.props)) {
    if (before[name] !== value) set(node, name, value, before[name]);
  }
  drawn.set(node, view);
  if (!view.tag.includes("-")) place(node, view.children); // an element of our own draws what is inside it
}

/** @param {any} node @param {string} name @param {any} value @param {any} before */
function set(node, name, value, before) {
  if (name === "key") return;
  if (name.startsWith("on")) listen(node, name.slice(2), value);
  else if (name === "style") restyle(node, value ?? {}, before ?? {});
  else if (PROPERTIES.has(name) && name in node) node[name] = value ?? (name === "value" ? "" : false);
  else if (typeof value === "object" && value !== null) node[name] = value;
  else if (value === undefined || value === null || value === false) node.removeAttribute(name);
  else if (name.startsWith("aria-")) node.setAttribute(name, `${value}`);
  else node.setAttribute(name, value === true ? "" : `${value}`);
}

/** @param {HTMLElement} node @param {Record<string, any>} wanted @param {Record<string, any>} before */
function restyle(node, wanted, before) {
  for (const name of Object.keys(before)) if (!(name in wanted)) node.style.removeProperty(name);
  for (const [name, value] of Object.entries(wanted)) node.style.setProperty(name, `${value}`);
}

/** @param {Node} node @param {string} kind @param {((event: Event) => void) | undefined} handler */
function listen(node, kind, handler) {
  const known = handlers.get(node) ?? new Map();
  handlers.set(node, known);
  if (!known.has(kind)) node.addEventListener(kind, (event) => known.get(kind)?.(event));
  known.set(kind, handler);
}
