// SPDX-License-Identifier: MIT
// The reading half of an AXI4 slave: bursts from AR become a request for each beat, and the answers go to R.
//
// The beats of the next burst follow at once, while answers of the last one are still on their way. It asks for no
// more than there is room for, so a master that does not take answers stops its own reads and no writes.
module pearl_axi_read
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned ADDR_BITS = 16,
    parameter int unsigned ID_BITS = 4,
    localparam int unsigned WORD_ADDR_BITS = ADDR_BITS - $clog2(DATA_WL / 8)
) (
    input logic clk_i,
    input logic rst_ni,

    input  logic                 ar_valid_i,
    output logic                 ar_ready_o,
    input  logic [  ID_BITS-1:0] ar_id_i,
    input  logic [ADDR_BITS-1:0] ar_addr_i,
    input  logic [          7:0] ar_len_i,
    input  logic [          2:0] ar_size_i,
    input  logic [          1:0] ar_burst_i,
    output logic                 r_valid_o,
    input  logic                 r_ready_i,
    output logic [  ID_BITS-1:0] r_id_o,
    output logic [  DATA_WL-1:0] r_data_o,
    output logic [          1:0] r_resp_o,
    output logic                 r_last_o,

    // Wants to ask for a word, and may do so in this cycle.
    output logic                       wants_o,
    input  logic                       grant_i,
    output logic  [WORD_ADDR_BITS-1:0] addr_o,
    // The answers to its requests.
    input  logic                       answer_i,
    input  logic  [       DATA_WL-1:0] data_i,
    input  resp_e                      resp_i
);

  logic beat_valid, last, room;
  logic [ID_BITS-1:0] id;
  logic [ADDR_BITS-1:0] addr;
  // The master picks the bytes out of whole words.
  logic unused_addr;
  assign unused_addr = ^addr;

  pearl_axi_address #(
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_address (
      .clk_i,
      .rst_ni,
      .valid_i(ar_valid_i),
      .ready_o(ar_ready_o),
      .id_i   (ar_id_i),
      .addr_i (ar_addr_i),
      .len_i  (ar_len_i),
      .size_i (ar_size_i),
      .burst_i(ar_burst_i),
      .valid_o(beat_valid),
      .id_o   (id),
      .addr_o (addr),
      .last_o (last),
      .next_i (grant_i),
      .end_i  (last)
  );

  assign wants_o = beat_valid && room;
  assign addr_o  = addr[ADDR_BITS-1-:WORD_ADDR_BITS];

  pearl_axi_answers #(
      .NOTE_BITS  (ID_BITS + 1),
      .ANSWER_BITS(DATA_WL + 2)
  ) u_answers (
      .clk_i,
      .rst_ni,
      .room_o  (room),
      .ask_i   (grant_i),
      .note_i  ({last, id}),
      .answer_i(answer_i),
      .data_i  ({resp_i, data_i}),
      .valid_o (r_valid_o),
      .note_o  ({r_last_o, r_id_o}),
      .data_o  ({r_resp_o, r_data_o}),
      .take_i  (r_valid_o && r_ready_i)
  );

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (wants_o || !grant_i)
      else $error("pearl_axi_read: a word was asked for that there was no room for");
    end
  end

endmodule
