// SPDX-License-Identifier: MIT
// pearl_axi_slave between any master that keeps to AXI4 and a memory port that answers anything, PORT_LATENCY
// cycles after it was asked. axi_properties.sv, bound to the slave, has the properties.
// Beside them: reads ask for as many words as they have beats, a write of part of a word changes that part of what
// the port granted, or nothing; and each kind of burst goes on unless its own master does not take or give a beat.
module axi_proof
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 16,
    parameter int unsigned ADDR_BITS = 4,
    localparam int unsigned ID_BITS = 2,
    localparam int unsigned STRB_BITS = DATA_WL / 8,
    localparam int unsigned WORD_ADDR_BITS = ADDR_BITS - $clog2(STRB_BITS)
) (
    input logic                 clk_i,
    input logic                 rst_ni,
    input logic [  ID_BITS-1:0] s_axi_awid,
    input logic [ADDR_BITS-1:0] s_axi_awaddr,
    input logic [          7:0] s_axi_awlen,
    input logic [          2:0] s_axi_awsize,
    input logic [          1:0] s_axi_awburst,
    input logic                 s_axi_awvalid,
    input logic [  DATA_WL-1:0] s_axi_wdata,
    input logic [STRB_BITS-1:0] s_axi_wstrb,
    input logic                 s_axi_wlast,
    input logic                 s_axi_wvalid,
    input logic                 s_axi_bready,
    input logic [  ID_BITS-1:0] s_axi_arid,
    input logic [ADDR_BITS-1:0] s_axi_araddr,
    input logic [          7:0] s_axi_arlen,
    input logic [          2:0] s_axi_arsize,
    input logic [          1:0] s_axi_arburst,
    input logic                 s_axi_arvalid,
    input logic                 s_axi_rready,
    input logic [  DATA_WL-1:0] rdata_i,
    input logic [          1:0] resp_i
);

  // Resets come at any time, and first of all.
  logic started_q = 1'b0;
  logic rst_n;
  assign rst_n = rst_ni && started_q;
  always_ff @(posedge clk_i) started_q <= 1'b1;

  logic req, we, fetch;
  logic [WORD_ADDR_BITS-1:0] addr;
  logic [  PORT_LATENCY-1:0] due_q;
  logic s_axi_awready, s_axi_wready, s_axi_bvalid, s_axi_arready, s_axi_rlast, s_axi_rvalid;
  logic [ID_BITS-1:0] s_axi_bid, s_axi_rid;
  logic [1:0] s_axi_bresp, s_axi_rresp;
  logic [DATA_WL-1:0] s_axi_rdata, wdata;

  always_ff @(posedge clk_i) begin
    if (!rst_n) due_q <= '0;
    else due_q <= PORT_LATENCY'({due_q, req});
  end

`ifdef PROPERTY_ONLY
  always_comb assume (rst_ni);
`endif
  always_comb assume (resp_i != 2'b01);

  pearl_axi_slave #(
      .DATA_WL  (DATA_WL),
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_slave (
      .rst_ni(rst_n),
      .req_o(req),
      .we_o(we),
      .fetch_o(fetch),
      .addr_o(addr),
      .wdata_o(wdata),
      .rvalid_i(due_q[PORT_LATENCY-1]),
      .rdata_i,
      .resp_i(resp_e'(resp_i)),
      .*
  );

  // Short for the slave's halves, and for the bursts that they have.
  logic read_wants, read_grant, write_wants, write_grant, write_done, w_valid, w_empty;
  logic [STRB_BITS-1:0] w_strb;
  logic [  DATA_WL-1:0] w_data;
  assign read_wants  = u_slave.read_wants;
  assign read_grant  = u_slave.read_grant;
  assign write_wants = u_slave.write_wants;
  assign write_grant = u_slave.write_grant;
  assign write_done  = u_slave.u_write.done;
  assign w_valid     = u_slave.u_write.w_valid;
  assign w_empty     = u_slave.u_write.w.empty;
  assign w_strb      = u_slave.u_write.w.strb;
  assign w_data      = u_slave.u_write.w.data;

  // ---- A write of part of a word ----

  // The port was asked for this word on behalf of a write, and now answers.
  logic fetching_q, fetched;
  logic [WORD_ADDR_BITS-1:0] fetch_addr_q;
  logic [  PORT_LATENCY-1:0] fetch_due_q;
  assign fetched = fetch_due_q[PORT_LATENCY-1];

  always_ff @(posedge clk_i) begin
    if (!rst_n) begin
      fetching_q  <= 1'b0;
      fetch_due_q <= '0;
    end else begin
      fetch_due_q <= PORT_LATENCY'({fetch_due_q, fetch});
      if (fetch) fetching_q <= 1'b1;
      else if (fetched) fetching_q <= 1'b0;
    end
    if (fetch) fetch_addr_q <= addr;
  end

  always_ff @(posedge clk_i) begin
    if (rst_n) begin
      if (fetch) fetch_reads : assert (req && !we);
      // Until the word is there nothing else is asked for; then it is written, or left alone.
      if (fetching_q && !fetched) fetch_alone : assert (!req);
      if (fetched) begin
        merge_granted : assert (req == (resp_i == RespOkay));
        if (req) merge_writes : assert (we && addr == fetch_addr_q);
        for (int unsigned i = 0; i < STRB_BITS; i++) begin
          if (req && !w_strb[i]) assert (wdata[i*8+:8] == rdata_i[i*8+:8]);
          if (req && w_strb[i]) assert (wdata[i*8+:8] == w_data[i*8+:8]);
        end
      end
      if (req && we && !fetched) whole_words : assert (&w_strb && wdata == w_data);
    end
  end

  // ---- A read ----

  // Words that were asked for, less those that were given.
  logic [8:0] asked_q;

  always_ff @(posedge clk_i) begin
    if (!rst_n) asked_q <= '0;
    else asked_q <= asked_q + 9'(req && !we && !fetch) - 9'(u_slave.u_properties.r_moves);
    if (rst_n && u_slave.u_properties.reads_q == '0) read_in_full : assert (asked_q == '0);
    if (rst_n && asked_q == '0) read_before : assert (!s_axi_rvalid);
  end

  // ---- Turns ----

  // Wanted the last turn, and the other kind had it.
  logic read_lost_q, write_lost_q;

  always_ff @(posedge clk_i) begin
    if (!rst_n) begin
      read_lost_q  <= 1'b0;
      write_lost_q <= 1'b0;
    end else begin
      if (read_grant || write_grant) begin
        read_lost_q  <= read_wants && write_grant;
        write_lost_q <= write_wants && read_grant;
      end
      one_turn : assert (!read_grant || !write_grant);
      read_in_turn : assert (!read_lost_q || !write_grant);
      write_in_turn : assert (!write_lost_q || !read_grant);
    end
  end

  // ---- An end ----

  // How many cycles it takes at most until a beat of a read is there, until a beat of a write is taken, and until a
  // burst that is written is answered.
  logic [31:0] read_due, fetch_left, end_due, read_needs, write_needs, answer_needs;
  logic read_moves, read_idle, write_moves, write_idle, read_taken, write_taken;
  assign read_taken  = u_slave.u_read.u_address.waiting_valid_q;
  assign write_taken = u_slave.u_write.u_address.waiting_valid_q;

  always_comb begin
    read_due   = 0;
    fetch_left = 0;
    end_due    = 0;
    for (int unsigned i = 0; i < PORT_LATENCY; i++) begin
      if (u_slave.reads_q[i]) read_due = PORT_LATENCY - i;
      if (fetch_due_q[i]) fetch_left = PORT_LATENCY - i;
      if (u_slave.u_write.ends_q[i]) end_due = PORT_LATENCY - i;
    end

    if (s_axi_rvalid) read_needs = 0;
    else if (read_due != 0) read_needs = read_due;
    else if (!u_slave.u_read.u_address.valid_q) read_needs = 2 * PORT_LATENCY + 3 + 32'(!read_taken);
    else if (fetch_left != 0) read_needs = PORT_LATENCY + 1 + fetch_left;
    else if (read_grant) read_needs = PORT_LATENCY + 1;
    else read_needs = 2 * PORT_LATENCY + 2;

    if (s_axi_bvalid) answer_needs = 0;
    else answer_needs = end_due;

    if (!u_slave.u_write.u_address.valid_q) write_needs = 2 * PORT_LATENCY + 4 + 32'(!write_taken);
    else if (!u_slave.u_write.room) write_needs = PORT_LATENCY + 3 + answer_needs;
    else if (fetch_left != 0) write_needs = fetch_left;
    else write_needs = PORT_LATENCY + 1 + 32'(!write_grant);
  end

  // Nothing is asked for, or the master's turn.
  assign read_moves = s_axi_rvalid;
  assign read_idle = u_slave.u_properties.reads_q == '0;
  assign write_moves = write_done;
  assign write_idle = !w_valid || s_axi_bvalid && !u_slave.u_write.room ||
      32'(u_slave.u_properties.writes_q) == 32'(u_slave.u_write.u_answers.u_notes.count);

  logic read_stays_q, write_stays_q, answer_stays_q;
  logic [31:0] read_needs_q, write_needs_q, answer_needs_q;
  always_ff @(posedge clk_i) begin
    read_stays_q   <= rst_n && !read_moves && !read_idle;
    write_stays_q  <= rst_n && !write_moves && !write_idle;
    answer_stays_q <= rst_n && !s_axi_bvalid && u_slave.u_write.u_answers.u_notes.count != '0;
    read_needs_q   <= read_needs;
    write_needs_q  <= write_needs;
    answer_needs_q <= answer_needs;
    if (rst_n) begin
      if (read_stays_q) read_goes_on : assert (read_needs < read_needs_q);
      if (write_stays_q) write_goes_on : assert (write_needs < write_needs_q);
      if (answer_stays_q) answer_goes_on : assert (answer_needs < answer_needs_q);
    end
  end

`ifndef PROPERTY_ONLY
  // ---- What makes it inductive ----

  localparam int unsigned DEPTH = 2 ** $clog2(PORT_LATENCY + 2);
  localparam int unsigned PTR_BITS = $clog2(DEPTH);
  // Where an identity and a length are in what a slice holds, and whether a beat is the last one.
  localparam int unsigned LEN_AT = 5;
  localparam int unsigned ID_AT = LEN_AT + 8 + ADDR_BITS;
  localparam int unsigned LAST_AT = DATA_WL + STRB_BITS + 2;

  logic ar_valid, ar_spare, aw_valid, aw_spare, w_spare, reading, writing;
  logic [31:0] noted, answered, waiting, written, told, ended;
  assign ar_valid = u_slave.u_read.u_address.u_slice.valid_q;
  assign ar_spare = ar_valid && !u_slave.u_read.u_address.u_slice.ready_q;
  assign aw_valid = u_slave.u_write.u_address.u_slice.valid_q;
  assign aw_spare = aw_valid && !u_slave.u_write.u_address.u_slice.ready_q;
  assign w_spare = w_valid && !u_slave.u_write.u_w.ready_q;
  assign reading = u_slave.u_read.u_address.valid_q;
  assign writing = u_slave.u_write.u_address.valid_q;
  // Of answers, those with a note, and those that are there.
  assign noted = 32'(u_slave.u_read.u_answers.u_notes.count);
  assign waiting = 32'(u_slave.u_read.u_answers.u_answers.count);
  assign written = 32'(u_slave.u_write.u_answers.u_notes.count);
  assign told = 32'(u_slave.u_write.u_answers.u_answers.count);

  function automatic logic is_beat(logic [LAST_AT:0] beat);
    logic [STRB_BITS-1:0] strb;
    strb = beat[DATA_WL+:STRB_BITS];
    return beat[LAST_AT-1-:2] == {&strb, strb == '0};
  endfunction

  // Of every note, and of what comes after them, how many bursts and beats of the next one are before it.
  logic [31:0] bursts[DEPTH+1];
  logic [8:0] beats[DEPTH+1];
  logic [ID_BITS:0] notes[DEPTH];
  always_comb begin
    bursts[0] = 0;
    beats[0]  = u_slave.u_properties.read_beats_q;
    for (int unsigned i = 0; i < DEPTH; i++) begin
      notes[i] = u_slave.u_read.u_answers.u_notes.mem[PTR_BITS'(u_slave.u_read.u_answers.u_notes.tail_q+i)];
      bursts[i+1] = bursts[i] + 32'(notes[i][ID_BITS]);
      beats[i+1] = notes[i][ID_BITS] ? '0 : beats[i] + 1'b1;
    end
    ended = bursts[noted];
  end

  always_ff @(posedge clk_i) begin
    if (rst_n) begin
      assert (u_slave.u_properties.in_reset_q != u_slave.u_properties.awake_q);
      if (u_slave.u_properties.in_reset_q) begin
        assert (!u_slave.u_read.u_address.u_slice.ready_q && !ar_valid && !read_taken && !reading);
        assert (!u_slave.u_write.u_address.u_slice.ready_q && !aw_valid && !write_taken && !writing);
        assert (!u_slave.u_write.u_w.ready_q && !w_valid);
        assert (noted == 0 && written == 0);
      end else begin
        assert (u_slave.u_read.u_address.u_slice.ready_q || ar_valid);
        assert (u_slave.u_write.u_address.u_slice.ready_q || aw_valid);
        assert (u_slave.u_write.u_w.ready_q || w_valid);
      end

      // The port's answers are those of either half.
      assert (u_slave.due_q == due_q);
      assert ((u_slave.reads_q & ~due_q) == '0);
      assert (fetch_due_q == u_slave.u_write.fetches_q);
      assert ((fetch_due_q & (~due_q | u_slave.reads_q)) == '0);
      assert ((fetch_due_q & (fetch_due_q - 1'b1)) == '0);

      // Each answer has a note, and so a place.
      assert (noted <= DEPTH && waiting <= DEPTH && written <= DEPTH && told <= DEPTH);
      assert (waiting + 32'($countones(u_slave.reads_q)) == noted);
      assert (told + 32'($countones(u_slave.u_write.ends_q)) == written);
      assert (32'(u_slave.u_read.u_answers.places_q) + noted == DEPTH);
      assert (32'(u_slave.u_write.u_answers.places_q) + written == DEPTH);
      assert (u_slave.u_read.u_answers.room_q == (noted != DEPTH));
      assert (u_slave.u_write.u_answers.room_q == (written != DEPTH));
      assert (32'(asked_q) == noted);

      // Bursts of reads: noted, under way, known, in the slice.
      for (int unsigned i = 0; i < DEPTH; i++) begin
        if (i < noted) begin
          assert (notes[i][ID_BITS-1:0] == u_slave.u_properties.read_ids_q[bursts[i]]);
          assert (notes[i][ID_BITS] == (beats[i] == 9'(u_slave.u_properties.read_lens_q[bursts[i]])));
          assert (beats[i] <= 9'(u_slave.u_properties.read_lens_q[bursts[i]]));
        end
        if (i < waiting)
          assert (u_slave.u_read.u_answers.u_answers.mem[
              PTR_BITS'(u_slave.u_read.u_answers.u_answers.tail_q+i)][DATA_WL+:2] != 2'b01);
        if (i < told)
          assert (u_slave.u_write.u_answers.u_answers.mem[
              PTR_BITS'(u_slave.u_write.u_answers.u_answers.tail_q+i)] != 2'b01);
      end
      assert (32'(u_slave.u_properties.reads_q) ==
              ended + 32'(reading) + 32'(read_taken) + 32'(ar_valid) + 32'(ar_spare));
      if (reading) begin
        assert (u_slave.u_read.u_address.beats_q.id == u_slave.u_properties.read_ids_q[ended]);
        assert (beats[noted] <= 9'(u_slave.u_properties.read_lens_q[ended]));
        assert (9'(u_slave.u_read.u_address.beats_q.left) + beats[noted] ==
                9'(u_slave.u_properties.read_lens_q[ended]));
        assert (u_slave.u_read.u_address.last_q == (u_slave.u_read.u_address.beats_q.left == '0));
      end else assert (beats[noted] == '0);
      if (read_taken) begin
        assert (u_slave.u_read.u_address.waiting_q.id == u_slave.u_properties.read_ids_q[ended+32'(reading)]);
        assert (u_slave.u_read.u_address.waiting_q.left ==
                u_slave.u_properties.read_lens_q[ended+32'(reading)]);
      end
      if (ar_valid) begin
        assert (u_slave.u_read.u_address.u_slice.data_q[ID_AT+:ID_BITS] ==
                u_slave.u_properties.read_ids_q[ended+32'(reading)+32'(read_taken)]);
        assert (u_slave.u_read.u_address.u_slice.data_q[LEN_AT+:8] ==
                u_slave.u_properties.read_lens_q[ended+32'(reading)+32'(read_taken)]);
      end
      if (ar_spare) begin
        assert (u_slave.u_read.u_address.u_slice.spare_q[ID_AT+:ID_BITS] ==
                u_slave.u_properties.read_ids_q[ended+32'(reading)+32'(read_taken)+1]);
        assert (u_slave.u_read.u_address.u_slice.spare_q[LEN_AT+:8] ==
                u_slave.u_properties.read_lens_q[ended+32'(reading)+32'(read_taken)+1]);
      end

      // And of writes, and their beats.
      for (int unsigned i = 0; i < DEPTH; i++) begin
        if (i < written)
          assert (u_slave.u_write.u_answers.u_notes.mem[
              PTR_BITS'(u_slave.u_write.u_answers.u_notes.tail_q+i)] ==
                  u_slave.u_properties.write_ids_q[i]);
      end
      assert (32'(u_slave.u_properties.writes_q) ==
              written + 32'(writing) + 32'(write_taken) + 32'(aw_valid) + 32'(aw_spare));
      if (writing) assert (u_slave.u_write.u_address.beats_q.id == u_slave.u_properties.write_ids_q[written]);
      if (write_taken)
        assert (u_slave.u_write.u_address.waiting_q.id ==
                u_slave.u_properties.write_ids_q[written+32'(writing)]);
      if (aw_valid)
        assert (u_slave.u_write.u_address.u_slice.data_q[ID_AT+:ID_BITS] ==
                u_slave.u_properties.write_ids_q[written+32'(writing)+32'(write_taken)]);
      if (aw_spare)
        assert (u_slave.u_write.u_address.u_slice.spare_q[ID_AT+:ID_BITS] ==
                u_slave.u_properties.write_ids_q[written+32'(writing)+32'(write_taken)+1]);
      assert (32'(u_slave.u_properties.datas_q) ==
              written + 32'(w_valid && u_slave.u_write.w.last) +
              32'(w_spare && u_slave.u_write.u_w.spare_q[LAST_AT]));
      if (w_valid) assert (is_beat(u_slave.u_write.u_w.data_q));
      if (w_spare) assert (is_beat(u_slave.u_write.u_w.spare_q));
      assert (u_slave.u_write.worst_q != 2'b01);

      // A fetch has its beat and its room.
      assert (fetching_q == (fetch_due_q != '0) && u_slave.u_write.fetching_q == fetching_q);
      if (fetching_q) begin
        assert (writing && w_valid && u_slave.u_write.room && !u_slave.u_write.w.full && !w_empty);
        assert (u_slave.u_write.addr_o == fetch_addr_q);
        assert (!u_slave.read_q && !write_lost_q);
      end
      if (read_lost_q) assert (read_wants && !u_slave.read_q);
      if (write_lost_q) assert (write_wants && u_slave.read_q);
    end
  end
`endif

endmodule
