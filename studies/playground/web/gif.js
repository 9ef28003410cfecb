// Pictures as an animated GIF: the 255 colours that are most frequent, and LZW.

const CODES = 4096;

/** Return the bytes of a GIF that repeats for ever; delay in hundredths of a second. */
export function gifOf(frames, width, height, delay) {
    const colours = paletteOf(frames),
        bytes = [];
    const word = (value) => bytes.push(value & 255, value >> 8);
    bytes.push(...[..."GIF89a"].map((each) => each.charCodeAt(0)));
    word(width);
    word(height);
    bytes.push(0xf7, 0, 0, ...colours.flat());
    bytes.push(0x21, 0xff, 11, ...[..."NETSCAPE2.0"].map((each) => each.charCodeAt(0)), 3, 1, 0, 0, 0);
    const chosen = new Map();
    for (const pixels of frames) {
        bytes.push(0x21, 0xf9, 4, 0);
        word(delay);
        bytes.push(0, 0, 0x2c, 0, 0, 0, 0);
        word(width);
        word(height);
        bytes.push(0, 8);
        const data = compressed(indicesOf(pixels, colours, chosen));
        for (let at = 0; at < data.length; at += 255) {
            const block = data.slice(at, at + 255);
            bytes.push(block.length);
            for (const each of block) bytes.push(each);
        }
        bytes.push(0);
    }
    bytes.push(0x3b);
    return Uint8Array.from(bytes);
}

const coarse = (pixels, at) => ((pixels[at] >> 3) << 10) | ((pixels[at + 1] >> 3) << 5) | (pixels[at + 2] >> 3);

function paletteOf(frames) {
    const seen = new Map();
    for (let k = 0; k < frames.length; k += Math.ceil(frames.length / 8)) {
        for (let at = 0; at < frames[k].length; at += 4) {
            const key = coarse(frames[k], at);
            const known = seen.get(key);
            if (known) known.count += 1;
            else seen.set(key, { count: 1, colour: [...frames[k].subarray(at, at + 3)] });
        }
    }
    const best = [...seen.values()]
        .sort((a, b) => b.count - a.count)
        .slice(0, 256)
        .map((each) => each.colour);
    return [...best, ...Array.from({ length: 256 - best.length }, () => [0, 0, 0])];
}

function indicesOf(pixels, colours, chosen) {
    const indices = new Uint8Array(pixels.length / 4);
    for (let i = 0; i < indices.length; i++) {
        const key = coarse(pixels, 4 * i);
        let index = chosen.get(key);
        if (index === undefined) {
            let least = Infinity;
            colours.forEach((colour, k) => {
                const away = colour.reduce((sum, each, j) => sum + (each - pixels[4 * i + j]) ** 2, 0);
                if (away < least) [least, index] = [away, k];
            });
            chosen.set(key, index);
        }
        indices[i] = index;
    }
    return indices;
}

/** Return indices compressed as GIF has it: codes of 9 to 12 bits, the table begun anew when it is full. */
export function compressed(indices) {
    const bytes = [];
    let held = 0,
        bits = 0,
        size = 9,
        next = 258,
        table = new Map();
    const write = (code) => {
        held |= code << bits;
        bits += size;
        while (bits >= 8) {
            bytes.push(held & 255);
            held >>>= 8;
            bits -= 8;
        }
    };
    write(256);
    let prefix = indices[0];
    for (let i = 1; i < indices.length; i++) {
        const key = prefix * 256 + indices[i],
            known = table.get(key);
        if (known !== undefined) {
            prefix = known;
            continue;
        }
        write(prefix);
        if (next < CODES) {
            table.set(key, next++);
            if (next > 1 << size && size < 12) size += 1;
        } else {
            write(256);
            size = 9;
            next = 258;
            table = new Map();
        }
        prefix = indices[i];
    }
    write(prefix);
    write(257);
    if (bits) bytes.push(held & 255);
    return bytes;
}
