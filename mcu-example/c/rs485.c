#include "frames.h"

enum { START = 0x3E, ALL_MOTORS = 0xCD, LAST_ID = 32, CRC_START = 0xFFFF };

/* CRC-16/MODBUS, a byte at a time. */
static const uint16_t CRC_TABLE[256] = {
#include "crc_table.inc"
};

static uint16_t crc_add(uint16_t crc, uint8_t byte)
{
    return (uint16_t)(crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 0xFF]);
}

void c_encode_line(uint8_t id, const uint8_t data[DATA_LENGTH], uint8_t line[LINE_LENGTH])
{
    line[0] = START;
    line[1] = id;
    line[2] = DATA_LENGTH;
    for (size_t i = 0; i < DATA_LENGTH; i++) {
        line[3 + i] = data[i];
    }
    uint16_t crc = CRC_START;
    for (size_t i = 0; i < LINE_LENGTH - 2; i++) {
        crc = crc_add(crc, line[i]);
    }
    line[11] = (uint8_t)crc;
    line[12] = (uint8_t)(crc >> 8);
}

static enum fed begin_anew(struct receiver *receiver, enum fed fed)
{
    receiver->length = 0;
    receiver->crc = CRC_START;
    return fed;
}

enum fed c_feed(struct receiver *receiver, uint8_t byte)
{
    uint8_t at = receiver->length;
    if (at == 0 && byte != START) {
        return begin_anew(receiver, FED_NOTHING);
    }
    if (at == 1 && (byte == 0 || byte > LAST_ID) && byte != ALL_MOTORS) {
        return begin_anew(receiver, FED_BROKEN);
    }
    if (at == 2 && byte != DATA_LENGTH) {
        return begin_anew(receiver, FED_BROKEN);
    }
    receiver->line[at] = byte;
    receiver->length = (uint8_t)(at + 1);
    if (at < LINE_LENGTH - 2) {
        receiver->crc = crc_add(receiver->crc, byte);
        return FED_NOTHING;
    }
    if (at == LINE_LENGTH - 2) {
        return FED_NOTHING;
    }
    bool is_whole = receiver->line[LINE_LENGTH - 2] == (uint8_t)receiver->crc &&
                    receiver->line[LINE_LENGTH - 1] == (uint8_t)(receiver->crc >> 8);
    return begin_anew(receiver, is_whole ? FED_FRAME : FED_BROKEN);
}

enum fed c_want(struct receiver *receiver, uint8_t byte)
{
    (void)receiver;
    (void)byte;
    return FED_NOTHING;
}

void c_nothing(const void *input, void *output)
{
    (void)input;
    (void)output;
}
