// What the server sends, as types for the checker: nothing of it is loaded. Times are ns since the start of the run;
// robots, elements and kinds of events are numbers, -1 where there is none.

/**
 * @typedef {[x: number, y: number]} Point
 * @typedef {[x: number, y: number, width: number, height: number]} Box
 */

/**
 * An element of a model (`catalogue.py`): what is empty is left out.
 *
 * @typedef {object} Element
 * @property {string} id
 * @property {string} [name]
 * @property {string} tag that of BPMN, as `userTask`
 * @property {number} [file] the number of its file; the first if there is none
 * @property {number} [body] the process or sub-process that it is in
 * @property {number} [calls] the process that a call activity calls
 * @property {number} [plane] that it is drawn on
 * @property {number} [inside] the plane that shows what is in it
 * @property {string} [doc]
 * @property {string} [source]
 * @property {string} [script]
 * @property {string} [condition]
 * @property {[topic: string, way: "throw" | "catch", name?: string][]} [topics]
 * @property {string[]} [uses] variables of progress that it names
 * @property {string[]} [exits] in words: what can end what it does
 * @property {Field[]} [form]
 * @property {string[]} [users]
 * @property {string[]} [groups]
 * @property {number} [due] s that it has, by a boundary timer
 * @property {Map<string, boolean>} [about] variables that it, or what it calls, is about; kept by `roster.js`
 */

/**
 * A field of a form (`forms.py`).
 *
 * @typedef {object} Field
 * @property {string} key a dotted one is a field inside a field
 * @property {string} label
 * @property {string} [kind]
 * @property {unknown} [value]
 * @property {boolean} [required]
 * @property {[value: unknown, text: string][]} [options]
 * @property {string} [unit]
 * @property {string} [help]
 * @property {string} [hint]
 * @property {string} [pattern]
 * @property {number} [min]
 * @property {number} [max]
 * @property {number | string} [step]
 * @property {number} [minLength]
 * @property {number} [maxLength]
 */

/**
 * A robot of the mission.
 *
 * @typedef {object} Robot
 * @property {string} name
 * @property {number} [pool]
 * @property {number} [plane]
 * @property {[time: number, plane: number][]} [planes]
 * @property {number[]} [starts] events of which its process waits for one before it begins
 */

/**
 * A finding of `fame check`.
 *
 * @typedef {object} Finding
 * @property {number} element
 * @property {"error" | "warning" | "note"} severity
 * @property {string} text
 * @property {string} where
 * @property {number} [line]
 */

/**
 * What a page receives first (`mission.py`).
 *
 * @typedef {object} Mission
 * @property {"recording" | "live" | "team" | "model" | ""} kind
 * @property {string} title
 * @property {[text: string, cls: string, title: string][]} chips
 * @property {string[]} notices
 * @property {Robot[]} robots
 * @property {number[]} order of the robots, by number
 * @property {Element[]} elements
 * @property {{file: string, title: string}[]} planes
 * @property {string[]} models
 * @property {Object<string, Field[]>} types by topic
 * @property {Object<string, string>} sentences why a token waits (`wait_sentences.py`), with names in braces
 * @property {number} reading how much of the recording has been read, 0 to 1
 * @property {IndexRow[]} blocks
 * @property {number} end
 * @property {string[]} control commands that are allowed
 * @property {boolean} messages whether it has some
 * @property {number | string} [version] another one when it has changed: the news `reload` names it
 * @property {Finding[]} [findings]
 * @property {[title: string, advice: string]} [empty]
 * @property {[robot: string, part: string][]} [faults] that can be injected
 * @property {{user: string, role: string}} [person] who uses the page
 * @property {any} [heat] `heat.py`
 * @property {any} [change] `change.py`
 * @property {any} [monitor] `replay.py`
 */

/** @typedef {[number: number, start: number, end: number, events: number]} IndexRow */

/**
 * A token that waits (docs/recording_format.md), and its element's number.
 *
 * @typedef {object} Wait
 * @property {string} key
 * @property {number} e
 * @property {string} element its id
 * @property {number} scope
 * @property {number} since
 * @property {string} kind
 * @property {string} text what it waits for, in words
 * @property {string[]} [topics]
 * @property {Object<string, string[]>} [publishers] by topic
 * @property {Object<string, string>} [senders] robots, or other nodes, and a topic that each publishes
 * @property {{text: string, reads?: string[]}[]} [conditions]
 * @property {number} [gone] since when its server is gone
 * @property {number} [silent] since when its server has said nothing
 * @property {string[]} [mismatches]
 * @property {boolean} [suspended]
 * @property {string} [by] who suspended it
 * @property {{time: number, why: string}} [missed] a message that did not count
 * @property {string} [error]
 */

/**
 * @typedef {[r: number, i: number, s: number, e: number, n: number, since: number]} TokenRow
 * @typedef {[r: number, s: number, i: number, parent: number, openers: number[], depth: number]} ScopeRow
 * @typedef {[time: number, r: number, s: number, values: Object<string, any> | null, gone: string[]]} VariablesRow
 * @typedef {[time: number, r: number, tokens: Wait[], gone: string[]]} WaitsRow
 * @typedef {[time: number, r: number, text: string]} CircleRow
 * @typedef {[time: number, topic: string, sender: string, content: any]} MessageRow
 * @typedef {[time: number, r: number, pose: any]} PoseRow
 * @typedef {[time: number, name: string, value: any]} WorldRow
 * @typedef {[time: number, change: any]} PropertyRow
 */

/**
 * The state at the start of a block (`state.py`).
 *
 * @typedef {object} Key
 * @property {TokenRow[]} tokens
 * @property {[r: number, e: number, completed: number, failed: number, cancelled: number][]} counts
 * @property {ScopeRow[]} scopes
 * @property {[r: number, s: number, values: Object<string, [value: any, since: number]>][]} variables
 * @property {[r: number, tokens: Wait[]][]} waits
 * @property {[r: number, text: string][]} circles
 * @property {[r: number, ended: number, failed: number, how: string, time: number][]} [ends]
 * @property {[r: number, pose: any][]} poses
 * @property {Object<string, any>} world
 */

/**
 * Lists of changes; each entry begins with its time.
 *
 * @typedef {object} Changes
 * @property {VariablesRow[]} variables
 * @property {WaitsRow[]} waits
 * @property {CircleRow[]} circles robots that wait for each other from then on, and what can end that; or no more
 * @property {MessageRow[]} messages
 * @property {PoseRow[]} poses
 * @property {WorldRow[]} world
 * @property {PropertyRow[]} properties
 */

/**
 * Columns of events: time, robot, instance, scope, element, kind.
 *
 * @typedef {Record<"t" | "r" | "i" | "s" | "e" | "w", number[]>} Columns
 */

/**
 * A block as the server sends it (`blocks.py`): all of it with its key, or what has come since `first` and `at`.
 *
 * @typedef {Columns & Changes & BlockHead} BlockData
 *
 * @typedef {object} BlockHead
 * @property {number} number
 * @property {number} start
 * @property {number} end
 * @property {Key} [key]
 * @property {number} first
 * @property {Object<string, number>} at
 * @property {Object<string, any>} d details of events, by their place
 * @property {ScopeRow[]} scopes
 * @property {number} [until]
 * @property {number} [size] characters of its JSON, if the server has said so
 */

export {};
