// The JavaScript side of one context: the names that scripts find, and how they are run.
//
// Nothing of the host can be called from here. Each step gets a text (changes of variables, the message of a callback)
// and returns one (changes, commands to the robot). The most important built-ins are saved before the first script runs,
// and the host checks every text: a script that changes built-in objects can only harm itself.
//
//   activation   one run of a script: over when it has called next(); its callbacks stay until they are destroyed
//   callback     a function with a number that the host calls by: subscription, timer, response, promise of a service
//   environment  the variables of the host, as far as they are known here
(() => {
"use strict";
const { stringify, parse } = JSON;
const { defineProperty, getOwnPropertyDescriptor, getPrototypeOf } = Reflect;
const { is, keys: namesOf, prototype: plain } = Object;
const { isArray } = Array;
const { isFinite, isSafeInteger } = Number;
const { slice } = String.prototype;
const { then } = Promise.prototype;
const { captureStackTrace } = Error;
const LARGE = 10000; // characters: longer collections are compared only after a script has read them
const HIDDEN = "\0"; // the only key of an object that represents a number JSON does not have
const SPECIAL = ["NaN", "Infinity", "-Infinity"];

let settings = { namespace: "/", name: "", seed: 1, stored: false };
let now = 0; // ms since 1970, on the engine's clock
let count = 0; // of steps
let numbers = 0; // of activations and callbacks
let current = null; // the running activation, or the last one
let scope = null; // its `this`
let commands = []; // to the robot, as JSON texts
let rejected = []; // [promise, reason]
const activations = new Map(); // not over yet
const callbacks = new Map();
const handled = new WeakSet(); // promises with reactions
const output = {};

// ---- values ---------------------------------------------------------------------------------------------------------

const special = (key, value) => (typeof value === "number" && !isFinite(value) ? { [HIDDEN]: `${value}` } : value);
const restored = (key, value) =>
    value !== null && typeof value === "object" && SPECIAL.includes(value[HIDDEN]) ? Number(value[HIDDEN]) : value;

// The JSON text of a value; `undefined` if it cannot be serialised.
function encode(value) {
    if (typeof value === "number" && isFinite(value)) return `${value}`;
    try {
        const text = stringify(value);
        return text !== undefined && text.includes("null") ? stringify(value, special) : text;
    } catch (error) {
        if (error instanceof InternalError) throw error;
        return undefined; // it contains itself, or refuses
    }
}

// What in a value is other data when it comes back from its JSON text, in words; empty if there is nothing.
function altered(value) {
    try {
        return difference(value);
    } catch { // of a class or a getter
        return "an object that refuses to be read";
    }
}

function difference(value) {
    if (typeof value !== "object") {
        if (is(value, -0)) return "a negative zero";
        return ["bigint", "function", "symbol", "undefined"].includes(typeof value) ? `a value of type ${typeof value}` : "";
    }
    if (value === null) return "";
    const isList = isArray(value), prototype = isList ? null : getPrototypeOf(value);
    if (prototype !== null && prototype !== plain) return `a value of type ${prototype.constructor?.name}`;
    const names = namesOf(value);
    if (isList && names.length !== value.length) return "an array with holes or names";
    for (let index = 0; index < names.length; index += 1) {
        const inner = difference(value[names[index]]);
        if (inner) return inner;
    }
    return "";
}

// A long concatenated text is a tree inside, which the host cannot read: flatten it.
const whole = (text) => (text.length > 256 ? slice.call(text, 0) : text);

const decode = (text) => (text.includes("\\u0000") ? parse(text, restored) : parse(text));

const fixed = (object, name, value) => defineProperty(object, name, { value, writable: true, configurable: true });
fixed(BigInt.prototype, "toJSON", function toJSON() {
    const number = Number(this); // a larger number keeps all its digits as text
    return isSafeInteger(number) || !isFinite(number) ? number : { [HIDDEN]: `${this}n` };
});
fixed(Map.prototype, "toJSON", function toJSON() { return Object.fromEntries(this); });
fixed(Set.prototype, "toJSON", function toJSON() { return [...this]; });
fixed(Object.getPrototypeOf(Int8Array).prototype, "toJSON", function toJSON() { return Array.from(this); });

function reject(text, caller) {
    const error = new TypeError(text);
    captureStackTrace(error, caller);
    throw error;
}

// What was thrown, as data. An error with a code is a BPMN error.
function describe(thrown) {
    if (typeof thrown === "string") return { text: thrown, stack: "" };
    try {
        const { message, stack = "", errorCode, code = errorCode } = Object(thrown);
        if (typeof code === "string" || typeof code === "number") {
            return { text: `${message ?? code}`, stack: `${stack}`, code: `${code}` };
        }
        return { text: thrown instanceof Error ? `${thrown}` : `${message ?? encode(thrown)}`, stack: `${stack}` };
    } catch (error) {
        const isMemory = error === null || error instanceof InternalError;
        return { text: isMemory ? "InternalError: out of memory" : "an error that cannot be shown", stack: "" };
    }
}

// ---- variables ------------------------------------------------------------------------------------------------------

class Unread { // a collection that the host has set and no script has read yet
    constructor(text) { this.text = text; }
}

// Remember the text of a collection that the host knows.
function agree(environment, name, text) {
    environment.agreed.set(name, text);
    if (text?.length > LARGE) environment.hasLarge = true;
}

// The variable, parsed when it is first read.
function read(environment, name) {
    let value = environment.values[name];
    if (value instanceof Unread) {
        value = environment.values[name] = decode(value.text);
        agree(environment, name, encode(value));
    }
    if (environment.agreed.get(name)?.length > LARGE) {
        environment.large.add(name);
        if (current.large === NONE) current.large = new Set();
        current.large.add(name);
    }
    return value;
}

function write(environment, name, value) {
    if (typeof name !== "string" || (name[0] === "_" && name[1] === "_")) {
        reject(`${String(name)} cannot be the name of a variable`, write);
    }
    environment.values[name] = value;
    if (!environment.changed.includes(name)) environment.changed.push(name);
    return true;
}

const isNode = (name, values) => (name === "ros_node" || name === "node") && !Object.hasOwn(values, name);

function handler(environment) {
    return {
        get(values, name) {
            const value = values[name];
            if (typeof value !== "object" && value !== undefined) return value;
            if (value && !environment.hasLarge && !(value instanceof Unread)) return value;
            return isNode(name, values) ? node : read(environment, name);
        },
        has: (values, name) => name in values || isNode(name, values),
        set: (values, name, value) => write(environment, name, value),
        defineProperty: (values, name, given) => "value" in given && write(environment, name, given.value),
        deleteProperty: (values, name) => write(environment, name, undefined) && delete values[name],
        getOwnPropertyDescriptor(values, name) {
            read(environment, name);
            return getOwnPropertyDescriptor(values, name);
        },
        setPrototypeOf: () => false,
        preventExtensions: () => false,
    };
}

const keys = { __proto__: null }; // name -> its text

class Environment {
    constructor() {
        this.values = {};
        this.agreed = new Map(); // name -> text of a collection, as the host knows it
        this.changed = []; // names
        this.hasLarge = false; // whether there has been a large one
        this.large = new Set(); // names of large collections that were read in this step
        const variables = new Proxy(this.values, handler(this));
        this.shown = { variables, output };
    }
}

// Apply what the host has changed: {name: value}, {name: text of a collection}, [deleted name].
function update(environment, text) {
    const [values, collections, gone] = decode(text);
    for (const name of Object.keys(values)) environment.values[name] = values[name];
    for (const name of Object.keys(collections)) environment.values[name] = new Unread(collections[name]);
    for (const name of gone) delete environment.values[name];
    for (const name of [...Object.keys(values), ...Object.keys(collections), ...gone]) environment.agreed.delete(name);
}

// What scripts have changed, as text; empty if nothing has changed.
function changes(environment) {
    const { values, agreed, changed, large } = environment;
    if (agreed.size) {
        agreed.forEach((text, name) => { // a third of the time of `for ... of`
            if (changed.includes(name) || (text.length > LARGE && !large.has(name))) return;
            if (encode(values[name]) !== text) changed.push(name);
        });
        if (large.size) large.clear();
    }
    if (!changed.length) return "";
    let set = "", gone = "", kept = "", other = "";
    for (let index = 0; index < changed.length; index += 1) {
        const name = changed[index];
        if (values[name] === 0) values[name] = 0; // as the host knows it, not a negative zero
        const value = values[name], text = encode(value);
        const key = keys[name] ?? (keys[name] = stringify(name));
        if (value === undefined) {
            gone += gone ? `,${key}` : key;
            delete values[name]; // as for the host
        } else if (text === undefined) kept += kept ? `,${key}` : key;
        else set += set ? `,${key}:${text}` : `${key}:${text}`;
        if (settings.stored && text !== undefined) {
            const what = altered(value);
            if (what) other += `${other && ","}${key}:${stringify(what)}`;
        }
        if (agreed.size) agreed.delete(name);
        if (typeof value === "object" && value !== null && text !== undefined) agree(environment, name, text);
    }
    environment.changed = [];
    return `"set":{${set}}` + (gone && `,"gone":[${gone}]`) + (kept && `,"kept":[${kept}]`) + (other && `,"altered":{${other}}`);
}

// ---- activations ----------------------------------------------------------------------------------------------------

const NONE = new Set();

// `over` is the step in which next() was called, `value` its argument, `error` a description, `large` the names of large
// collections that it has read.
class Activation {
    constructor(script, environment) {
        this.number = ++numbers;
        this.script = script;
        this.environment = environment;
    }
}
Object.assign(Activation.prototype, { over: 0, value: undefined, error: undefined, callbacks: NONE, large: NONE }); // cheaper there

// `this` of a script.
class Scope {
    #activation;
    constructor(activation) { this.#activation = activation; }
    get environment() { return this.#activation.environment.shown; }
    get id() { return this.#activation.script.id; }
    get type() { return this.#activation.script.type; }
    get fields() { return { routingKey: "execute.start", exchange: "execution" }; }
    get content() { return { id: this.id, type: this.type, executionId: `${this.id}_${this.#activation.number}` }; }
    get properties() { return {}; }
    get next() { return nextOf(this.#activation); }
    get logger() { return console; }
    get console() { return console; }
    get setTimeout() { return setTimeout; }
    get clearTimeout() { return clearTimeout; }
}
const nextOf = (activation) => (error, value) => advance(activation, error, value);

function advance(activation, error, value) {
    if (!activation.over) {
        activation.over = count;
        if (error) activation.error = describe(error);
        else if (value !== undefined) output[activation.script.id] = activation.value = value;
        if (activation !== current) end(activation, activation.error ?? null);
    } else if (activation.over === count && !activation.error) {
        activation.error = { text: "next() was called twice", stack: here(advance) };
    } else if (activation.over !== count && !activation.late) {
        activation.late = true;
        command("late", here(advance), activation.script.id);
    }
}

function fail(activation, thrown) {
    activation.over = count;
    activation.error = describe(thrown);
}

function listen(call, once) {
    const number = ++numbers;
    callbacks.set(number, { activation: current, call, once });
    if (current.callbacks === NONE) current.callbacks = new Set();
    current.callbacks.add(number);
    return number;
}

function drop(number) {
    const callback = callbacks.get(number);
    if (callback === undefined) return;
    const { activation } = callback;
    callbacks.delete(number);
    activation.callbacks.delete(number);
    if (activation !== current && !activation.callbacks.size) {
        if (activation.over) activations.delete(activation.number);
        else end(activation, { text: "lost the last callback that could have called next()", stack: "" });
    }
}

// End an activation in the step of another one.
function end(activation, error) {
    activation.over ||= count;
    command("end", activation.number, error);
    if (!activation.callbacks.size) activations.delete(activation.number);
}

// ---- commands to the robot ------------------------------------------------------------------------------------------

const command = (...parts) => commands.push(`[${parts.map((part) => encode(part) ?? "null").join()}]`);

// Where in the script `caller` was called, as a stack.
function here(caller) {
    const place = {};
    captureStackTrace(place, caller);
    return place.stack;
}

function texts(what, caller, ...values) {
    for (const value of values) {
        if (typeof value !== "string" || !value) reject(`${what}: ${encode(value)} is not a name`, caller);
    }
}

function called(what, caller, value) {
    if (typeof value !== "function") reject(`${what}: expected a function to call back`, caller);
    return value;
}

class Publisher {
    constructor(type, topic) { this.type = type; this.topic = topic; }
    publish(message) { command("publish", here(this.publish), this.type, this.topic, message); }
    toJSON() { return undefined; }
}

class Subscription {
    constructor(topic, number) { this.topic = topic; this.number = number; }
    toJSON() { return undefined; }
}

class Client {
    constructor(type, service) { this.type = type; this.service = service; }
    waitForService(ms) {
        return new Promise((resolve) =>
            command("wait", here(this.waitForService), listen(resolve, true), this.type, this.service, ms));
    }
    sendRequest(request, callback) {
        const number = listen(called("sendRequest", this.sendRequest, callback), true);
        const place = here(this.sendRequest); // also for an error that comes later
        command("request", place, number, this.type, this.service, request, place);
    }
    toJSON() { return undefined; }
}

const node = {
    namespace: () => settings.namespace,
    name: () => settings.name,
    getLogger: () => console,
    createPublisher(type, topic) {
        texts("createPublisher", node.createPublisher, type, topic);
        command("advertise", here(node.createPublisher), type, topic);
        return new Publisher(type, topic);
    },
    createSubscription(type, topic, ...rest) { // options may stand before the callback
        texts("createSubscription", node.createSubscription, type, topic);
        const number = listen(called("createSubscription", node.createSubscription, rest.at(-1)), false);
        command("subscribe", here(node.createSubscription), number, type, topic);
        return new Subscription(topic, number);
    },
    createClient(type, service) {
        texts("createClient", node.createClient, type, service);
        command("client", here(node.createClient), type, service);
        return new Client(type, service);
    },
    destroySubscription(subscription) {
        if (!(subscription instanceof Subscription)) {
            reject("destroySubscription: expected a subscription", node.destroySubscription);
        }
        drop(subscription.number);
        command("drop", subscription.number);
    },
    destroyPublisher() {},
    destroyClient() {},
    toJSON: () => undefined,
};

function setTimeout(callback, ms, ...values) {
    const call = called("setTimeout", setTimeout, callback);
    const number = listen(() => call(...values), true);
    command("timer", number, ms > 1 && ms < 2 ** 31 ? Number(ms) : 1); // as in Node.js
    return number;
}

function clearTimeout(timer) {
    const number = typeof timer === "string" ? Number(timer) : timer;
    if (!callbacks.has(number)) return;
    drop(number);
    command("drop", number);
}

const spoken = (value) =>
    typeof value === "string" ? value : value instanceof Error ? `${value}` : encode(value) ?? String(value);
const log = (level) => (...values) => { command("log", level, values.map(spoken).join(" ")); };
const console = { log: log("info"), info: log("info"), debug: log("debug"), trace: log("debug"), warn: log("warning"),
    error: log("error") };

// ---- global names ---------------------------------------------------------------------------------------------------

// A function of a script that is called without an object has the global object for `this`.
for (const name of Object.getOwnPropertyNames(Scope.prototype).filter((name) => name !== "constructor")) {
    defineProperty(globalThis, name, {
        get: () => scope?.[name],
        set: (value) => { defineProperty(scope, name, { value, writable: true, configurable: true }); },
        configurable: true,
    });
}
fixed(globalThis, "performance", { now: () => now });

// The time is the engine's, and random numbers are repeatable (G. Marsaglia, Xorshift RNGs, 2003).
const RealDate = Date;
function EngineDate(...values) {
    if (!new.target) return new RealDate(now).toString();
    return Reflect.construct(RealDate, values.length ? values : [now], new.target);
}
EngineDate.prototype = RealDate.prototype;
EngineDate.now = () => Math.floor(now);
EngineDate.UTC = RealDate.UTC;
EngineDate.parse = RealDate.parse;
fixed(EngineDate, "name", "Date");
fixed(RealDate.prototype, "constructor", EngineDate);
fixed(globalThis, "Date", EngineDate);

fixed(Math, "random", function random() {
    settings.seed ^= settings.seed << 13;
    settings.seed ^= settings.seed >>> 17;
    settings.seed ^= settings.seed << 5;
    return (settings.seed >>> 0) / 2 ** 32;
});

// Report errors in reactions of promises unless the script handles the promise that `then` returns.
fixed(Promise.prototype, "then", function (fulfilled, failed) {
    handled.add(this);
    const promise = then.call(this, fulfilled, failed);
    then.call(promise, undefined, (reason) => rejected.push([promise, reason]));
    return promise;
});

// ---- called by the host ---------------------------------------------------------------------------------------------

const isAnswer = (value, mode) => !(value instanceof Promise) && (value !== undefined || mode === "expression");

// Run a script. A condition or value must return its result at once.
function begin(script, environment, time, text) {
    const activation = current = new Activation(script, environment);
    scope = new Scope(activation);
    count += 1;
    now = time;
    try {
        if (text !== null) update(environment, text);
        const run = script.run(nextOf(activation), environment.shown, script.id, script.type);
        const value = run.call(scope);
        if (script.mode !== "script" && !activation.over && isAnswer(value, script.mode)) {
            activation.over = count;
            activation.value = value;
        }
    } catch (error) {
        fail(activation, error);
    }
    return report(activation, true);
}

// Call back. `payload` is a JSON text.
function resume(number, payload, time, text) {
    const callback = callbacks.get(number);
    if (callback === undefined) return undefined;
    const activation = current = callback.activation;
    scope = new Scope(activation);
    count += 1;
    now = time;
    if (callback.once) drop(number);
    try {
        if (text !== null) update(activation.environment, text);
        for (const name of activation.large) activation.environment.large.add(name); // it may hold references to them
        (0, callback.call)(decode(payload));
    } catch (error) {
        fail(activation, error);
    }
    return collect();
}

// The report about the running activation, after promises or an interruption.
const collect = () => report(current, false);

// The result of a step as text; `briefly`: if it is over without callbacks, only its changes or its truth value.
function report(activation, briefly) {
    const { over, value, error, callbacks } = activation;
    const changed = changes(activation.environment);
    if (briefly && over && error === undefined && callbacks === NONE && !commands.length && !rejected.length) {
        if (value === undefined) return changed && whole(`{${changed}}`);
        if (!changed && typeof value === "boolean") return value;
    }
    const parts = [`"number":${activation.number},"over":${over > 0}`];
    const unseen = rejected.filter(([promise]) => !handled.has(promise)).map(([, reason]) => describe(reason));
    if (changed) parts.push(changed);
    if (value !== undefined) parts.push(`"value":${encode(value) ?? "null"}`);
    if (error !== undefined) parts.push(`"error":${stringify(error)}`);
    if (commands.length) parts.push(`"commands":[${commands.join()}]`);
    if (unseen.length) parts.push(`"rejected":${stringify(unseen)}`);
    commands = [];
    rejected = [];
    activation.error = undefined; // it is reported
    if (over && !callbacks.size) activations.delete(activation.number);
    else activations.set(activation.number, activation);
    return whole(`{${parts.join()}}`);
}

// End an activation (the running one without a number); returns the numbers of its callbacks as text.
function cancel(number) {
    const activation = number === undefined ? current : activations.get(number);
    if (activation === undefined) return "[]";
    const dropped = [...activation.callbacks];
    activation.over ||= count;
    dropped.forEach(drop);
    activations.delete(activation.number);
    return stringify(dropped);
}

const host = {
    begin, resume, collect, cancel,
    load: (run, id, type, mode) => ({ run, id, type, mode }),
    open: () => new Environment(),
    keep(environment, name, value) {
        if (value === undefined) delete environment.values[name];
        else environment.values[name] = value;
        environment.agreed.delete(name);
    },
    kept: (environment, name) => environment.values[name],
    configure: (text) => { settings = parse(text); },
};
return (name) => host[name];
})()
